#!/bin/bash
# asn1tools 0.169.0, UPER: the content of an information object's open type is neither encoded nor checked.
#
# ETSI's Collective Perception Message wraps its containers as {containerId, containerData}, where the id decides the
# type of the data (TS 103 324, WrappedCpmContainer; an information object class with a table constraint). asn1tools
# wants the data as bytes that were encoded before, gives bytes back, and takes any bytes at all: a value of the type
# that the id names is refused, and bytes that are no such value, or a container under another container's id, pass
# encode(..., check_constraints=True) without a word. A sender has to encode containers first, a receiver to decode
# them afterwards, and each has to compare id and type on its own.
#
# Seen (2026-11-29):
#     a value of the type that id 5 names: TypeError, a bytes-like object is required, not 'dict'
#     the same value encoded first: 4032a00070 -> {'id': 5, 'data': b'*\x00\x07'}
#     one byte where the type needs three: accepted, 401010 -> {'id': 5, 'data': b'\x01'}
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet asn1tools==0.169.0
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import asn1tools

TEXT = """
M DEFINITIONS AUTOMATIC TAGS ::= BEGIN
Number ::= INTEGER (1..16)
CONTENT ::= CLASS { &id Number UNIQUE, &Type } WITH SYNTAX { &Type IDENTIFIED BY &id }
Contents CONTENT ::= { { Objects IDENTIFIED BY 5 }, ... }
Wrapped ::= SEQUENCE { id CONTENT.&id ({Contents}), data CONTENT.&Type ({Contents}{@id}) }
Objects ::= SEQUENCE { count INTEGER (0..255), rest INTEGER (0..65535) }
END
"""
specification = asn1tools.compile_string(TEXT, "uper")
value = {"count": 42, "rest": 7}

try:
    specification.encode("Wrapped", {"id": 5, "data": value}, check_constraints=True)
    refused = False
except Exception as error:
    refused = True
    print("a value of the type that id 5 names: refused,", type(error).__name__, str(error)[:80])

content = specification.encode("Objects", value)
wrapped = specification.encode("Wrapped", {"id": 5, "data": content}, check_constraints=True)
back = specification.decode("Wrapped", wrapped)
print("encoded first:", wrapped.hex(), "->", back)
left_as_bytes = back == {"id": 5, "data": content}

nonsense = specification.encode("Wrapped", {"id": 5, "data": b"\x01"}, check_constraints=True)
print("one byte, where the type needs three: accepted,", nonsense.hex(), "->", specification.decode("Wrapped", nonsense))

as_seen = refused and left_as_bytes
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
