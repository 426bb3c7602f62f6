#!/usr/bin/env bash
# Puts the two hand networks (palm detection and hand landmarks, Apache-2.0) where the perception
# nodes look for them:
#
#     launch_scripts/fetch_hand_models.sh [DEST]        DEST defaults to models/hands
#
# They are taken out of the mediapipe 0.10.14 wheel, which pip downloads (about 36 MB) into a
# temporary folder and which is not installed. The files do not depend on the machine's
# architecture or on its Python version. Needs python3 with pip or with venv. Files that are
# there already and have the right checksum are left alone; a file appears under its final name
# only when it is complete.
set -euo pipefail

case "${1:-}" in
-h | --help)
    sed -n '2,/^set /p' "$0" | sed '$d; s/^# \{0,1\}//'
    exit 0
    ;;
esac
if [ "$#" -gt 1 ]; then
    echo "fetch_hand_models: one argument at most, the destination folder" >&2
    exit 2
fi

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
dest=${1:-"$root/models/hands"}
python=${PYTHON:-python3}
if ! command -v "$python" >/dev/null; then
    echo "fetch_hand_models: $python not found; install python3 and python3-pip" >&2
    exit 1
fi

# Exit code 0: both files are in DEST, complete and genuine.
# With a wheel as second argument, they are first extracted from it.
models() {
    "$python" - "$@" <<'PY'
import hashlib
import os
import sys
import tempfile
import zipfile

FILES = {
    "mediapipe/modules/palm_detection/palm_detection_full.tflite": (
        2339846, "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54"),
    "mediapipe/modules/hand_landmark/hand_landmark_full.tflite": (
        5478917, "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3"),
}


def genuine(data, size, digest):
    return len(data) == size and hashlib.sha256(data).hexdigest() == digest


def present(dest):
    for member, (size, digest) in FILES.items():
        try:
            with open(os.path.join(dest, os.path.basename(member)), "rb") as file:
                if not genuine(file.read(), size, digest):
                    return False
        except OSError:
            return False
    return True


def extract(dest, wheel):
    os.makedirs(dest, exist_ok=True)
    with zipfile.ZipFile(wheel) as archive:
        for member, (size, digest) in FILES.items():
            data = archive.read(member)
            if not genuine(data, size, digest):
                sys.exit(f"fetch_hand_models: {member} in {wheel} is not the file expected "
                         f"({len(data)} bytes instead of {size}, or another checksum)")
            handle, part = tempfile.mkstemp(dir=dest, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(data)
                os.chmod(part, 0o644)
                os.replace(part, os.path.join(dest, os.path.basename(member)))
            except BaseException:
                os.unlink(part)
                raise


dest = sys.argv[1]
if len(sys.argv) > 2:
    extract(dest, sys.argv[2])
sys.exit(0 if present(dest) else 1)
PY
}

if models "$dest"; then
    echo "hand networks: present in $dest"
    exit 0
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pip=("$python" -m pip)
if ! "${pip[@]}" --version >/dev/null 2>&1; then
    if ! "$python" -m venv "$work/venv" >"$work/venv.log" 2>&1; then
        echo "fetch_hand_models: $python has neither pip nor venv; install python3-pip or python3-venv" >&2
        exit 1
    fi
    pip=("$work/venv/bin/python" -m pip)
fi
echo "hand networks: downloading mediapipe 0.10.14 (about 36 MB)"
if ! "${pip[@]}" download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
    --implementation cp --python-version 3.11 --abi cp311 --platform manylinux_2_17_x86_64 \
    --dest "$work" mediapipe==0.10.14; then
    echo "fetch_hand_models: pip could not download mediapipe 0.10.14 (no network, or no such" \
        "package in the index that pip is set up for)" >&2
    exit 1
fi
models "$dest" "$work"/mediapipe-0.10.14-*.whl
echo "hand networks: palm_detection_full.tflite and hand_landmark_full.tflite are in $dest"
