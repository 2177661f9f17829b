"""Say early whether this Python will do: `python .ci/check_python.py` (any Python 3 runs it)."""

import sys

FOUND = "Python %d.%d" % sys.version_info[:2]

if sys.version_info < (3, 11):
    sys.stderr.write(
        FOUND + " is too old: assembly-twin needs 3.11, 3.12 or 3.13 (on the PATH, "
        "or make PYTHON=/path/to/python3).\n"
    )
    sys.exit(1)
if sys.version_info >= (3, 14):
    sys.stderr.write(
        "Note: "
        + FOUND
        + " is not what this project is tested with: 3.11, 3.12 and 3.13 are.\n"
    )
