#!/usr/bin/env bash
# Puts onnxruntime's shared library (MIT licence) where the ONNX backends of perception can load it:
#
#     launch_scripts/fetch_onnxruntime.sh [DEST]        DEST defaults to models/onnxruntime
#
# The library is taken out of the onnxruntime 1.31.1 wheel for this machine's Python, which pip
# downloads into a temporary folder and which is not installed. Prints the line that sets
# ORT_DYLIB_PATH. Needs python3 with pip. A library that is there already is left alone.
set -euo pipefail

version=1.31.1
case "${1:-}" in
-h | --help)
    sed -n '2,/^set /p' "$0" | sed '$d; s/^# \{0,1\}//'
    exit 0
    ;;
esac
if [ "$#" -gt 1 ]; then
    echo "fetch_onnxruntime: one argument at most, the destination folder" >&2
    exit 2
fi

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
dest=${1:-"$root/models/onnxruntime"}
python=${PYTHON:-python3}
library=$dest/libonnxruntime.so.$version

if [ ! -s "$library" ]; then
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
    if ! "$python" -m pip download --quiet --disable-pip-version-check --no-deps \
        --only-binary=:all: --dest "$work" "onnxruntime==$version"; then
        echo "fetch_onnxruntime: pip could not download onnxruntime $version (no network, no pip, or" \
            "no wheel for this machine)" >&2
        exit 1
    fi
    mkdir -p "$dest"
    "$python" - "$work" "$library" <<'PY'
import glob
import os
import sys
import zipfile

work, library = sys.argv[1:]
wheel, = glob.glob(os.path.join(work, "onnxruntime-*.whl"))
with zipfile.ZipFile(wheel) as archive:
    name = "onnxruntime/capi/" + os.path.basename(library)
    if name not in archive.namelist():
        sys.exit(f"fetch_onnxruntime: {os.path.basename(wheel)} has no {name}")
    with open(library + ".part", "wb") as out:
        out.write(archive.read(name))
os.replace(library + ".part", library)
PY
fi
echo "export ORT_DYLIB_PATH=$(cd "$dest" && pwd)/$(basename "$library")"
