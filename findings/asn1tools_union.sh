#!/bin/bash
# asn1tools 0.169.0, UPER (ITU-T X.691): of a value constraint with several parts only the first part is kept.
#
# ETSI's Common Data Dictionary bounds a perceived vehicle's class so (TS 102 894-2, ObjectClass):
#     vehicleSubClass TrafficParticipantType (unknown | passengerCar..tram | agricultural)
# X.691 counts from the least to the greatest value that any part allows: 0 to 14, four bits. asn1tools takes 0 to 0:
# the value gets no bit, and worse, its bits are written over the field before it. No error is raised; the decoder
# returns 0 for the class and the damaged neighbour. (encode(..., check_constraints=True) refuses every class but 0.)
# pycrate 0.8.1 encodes the same text as the standard says; asn1c's published C code for this type has 0 to 14, too.
#
# Seen (2026-11-29), before = 0, kind = 5, after = 170:
#     asn1tools 05aa -> {'before': 5, 'kind': 0, 'after': 170}
#     pycrate   005aa0 -> {'before': 0, 'kind': 5, 'after': 170}
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet asn1tools==0.169.0 pycrate==0.8.1
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import contextlib
import importlib
import io
import sys

import asn1tools
from pycrate_asn1c.asnproc import compile_text
from pycrate_asn1c.generator import PycrateGenerator

TEXT = """
M DEFINITIONS AUTOMATIC TAGS ::= BEGIN
Kind ::= INTEGER { unknown(0), car(5), tram(11), tractor(14) } (0..255)
A ::= SEQUENCE { before INTEGER (0..255), kind Kind (unknown | car..tram | tractor), after INTEGER (0..255) }
END
"""
value = {"before": 0, "kind": 5, "after": 170}

ours = asn1tools.compile_string(TEXT, "uper")
encoded = ours.encode("A", value)
decoded = ours.decode("A", encoded)
print("asn1tools", encoded.hex(), "->", decoded)

with contextlib.redirect_stdout(io.StringIO()):
    compile_text(TEXT)
    PycrateGenerator("compiled.py")
sys.path.insert(0, ".")
theirs = importlib.import_module("compiled").M.A
theirs.set_val(value)
expected = theirs.to_uper()
theirs.from_uper(expected)
print("pycrate  ", expected.hex(), "->", theirs.get_val())

# By hand: 00000000, 0101 (5 of 0..14), 10101010, four bits of padding.
assert expected.hex() == "005aa0" and theirs.get_val() == value
as_seen = encoded.hex() == "05aa" and decoded == {"before": 5, "kind": 0, "after": 170}
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
