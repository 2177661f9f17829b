"""Say early whether this Python will do: `python .ci/check_python.py` (any Python 3 runs it)."""

import sys

FOUND = "Python %d.%d" % sys.version_info[:2]

if sys.version_info < (3, 11):
    sys.stderr.write(
        FOUND + " is too old: assembly-twin needs 3.11 (python3.11 on the PATH, "
        "or make PYTHON=/path/to/python3.11).\n"
    )
    sys.exit(1)
if sys.version_info >= (3, 12):
    sys.stderr.write(
        "Note: "
        + FOUND
        + " is not what this project is tested with. PyBullet has ready-made packages "
        "up to Python 3.11 only; here pip compiles it, which needs a C++ compiler and takes "
        "about ten minutes. With Python 3.11 (make PYTHON=python3.11) it installs at once.\n"
    )
