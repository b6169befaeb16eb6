#!/usr/bin/env bash
# SciPy 1.17.1 parses the docstrings of some 800 of its functions, and writes them again, while `scipy.signal` and
# `scipy.stats` load: it adds sections to them. This took 0.26 to 0.29 of 0.65 to 0.79 s of processor time of the import,
# in each process that needs one filter or one distribution. `python -OO`, which drops docstrings, parses as often.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6
cd "$folder"
cat >count.py <<'PYTHON'
import sys

parsed = 0


def count(frame, event, argument):
    global parsed
    code = frame.f_code
    parsed += event == "call" and code.co_name == "_parse" and code.co_filename.endswith("_docscrape.py")


sys.setprofile(count)
import scipy.signal
import scipy.stats

sys.setprofile(None)
print(parsed)
PYTHON
plain=$("$folder/venv/bin/python" count.py)
stripped=$("$folder/venv/bin/python" -OO count.py)
"$folder/venv/bin/python" - "$plain" "$stripped" <<'PYTHON'
import sys
from importlib.metadata import version

plain, stripped = map(int, sys.argv[1:])
print("scipy", version("scipy"), "numpy", version("numpy"))
print("behaviour: docstrings parsed", plain, "with -OO", stripped)
as_described = plain > 300 and stripped > 300
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
