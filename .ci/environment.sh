# A fresh environment, for scripts that source this at the top of the repository: sets `work`, a folder
# that is removed at the end, `python` and `bin`, where the environment has its programs.

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Print a Python of a version, on the PATH or one of pyenv's; pyenv's names on the PATH may not run.
find_python() {
    local candidate
    for candidate in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1".*/bin/python; do
        if "$candidate" -c "" 2>/dev/null; then echo "$candidate"; return; fi
    done
}

python=
for version in 3.11 3.12 3.13; do
    python=${python:-$(find_python "$version")}
done
python=${python:-python3}
"$python" .ci/check_python.py

# Each process would compile the same modules otherwise. Those of packages that are used are compiled at
# their first import, which takes a fraction of what pip takes for all of them.
unset PYTHONDONTWRITEBYTECODE
"$python" -m compileall -q planning scheduling twin &
"$python" -m venv "$work/venv"
bin="$work/venv/bin"
"$bin/python" -m pip --disable-pip-version-check --quiet install --no-compile \
    --constraint constraints.txt --editable '.[dev]'

# `make VENV="$work/venv"` runs with this environment in the place of .venv.
touch "$work/venv/.created" "$work/venv/.installed" "$work/venv/.installed-dev"

# Print how long something took, and go on where it fails: `finish` then ends with status 1.
timed() {
    local name=$1 begin=$SECONDS
    shift
    "$@" || echo "$name: FAILED" | tee -a "$work/failed"
    echo "$name: $((SECONDS - begin)) s" >>"$work/times"
}

# Print the times of all parts and how it ended.
finish() {
    echo
    cat "$work/times"
    if [ -e "$work/failed" ]; then cat "$work/failed"; echo "$1: FAILED"; exit 1; fi
    echo "$1: ok"
}
