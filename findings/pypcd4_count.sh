#!/bin/bash
# pypcd4 1.5.1: a PCD file without the optional COUNT line cannot be read, nor an ascii one whose values tabs part.
#
# The file format of the Point Cloud Library says of COUNT: "By default, if COUNT is not present, all dimensions' count is
# set to 1." PCL reads such files, and parts the values of ascii files at any run of spaces and tabs. pypcd4 ends in a
# ValidationError ("count: Field required") for the first, and in a ValueError of numpy.loadtxt for the second.
#
# Way out: write the line COUNT 1 1 ... before WIDTH, and part ascii values by one space, before pypcd4 sees the bytes.
#
# Seen (2026-11-29): plain (2, 4); no COUNT ValidationError; tabs ValueError; two spaces ValueError
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pypcd4==1.5.1 numpy==2.4.6 pydantic==2.14.4 python-neo-lzf==0.3.5
"$folder/venv/bin/python" - <<'PYTHON'
import io
import sys

from pypcd4 import PointCloud

COUNT = "COUNT 1 1 1 1\n"
HEADER = f"VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n{COUNT}WIDTH 2\nHEIGHT 1\n"
PLAIN = HEADER + "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n1 2 3 0.5\n4 5 6 0.25\n"
head, body = PLAIN.split("DATA ascii\n")
texts = {
    "plain": PLAIN,
    "no COUNT": PLAIN.replace(COUNT, ""),
    "tabs": head + "DATA ascii\n" + body.replace(" ", "\t"),
    "two spaces": head + "DATA ascii\n" + body.replace(" ", "  "),
}


def read(text):
    try:
        return str(PointCloud.from_fileobj(io.BytesIO(text.encode())).numpy().shape)
    except ValueError as error:  # pydantic's ValidationError is one
        return type(error).__name__


found = {name: read(text) for name, text in texts.items()}
print("; ".join(f"{name} {result}" for name, result in found.items()))
expected = {"plain": "(2, 4)", "no COUNT": "ValidationError", "tabs": "ValueError", "two spaces": "ValueError"}
print("as seen" if found == expected else "changed")
sys.exit(0 if found == expected else 1)
PYTHON
