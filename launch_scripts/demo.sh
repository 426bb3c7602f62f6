#!/usr/bin/env bash
# One recorded demonstration -> parse -> multiply -> train -> the live graph carries the task out in the
# virtual lab, from a start pose that was not demonstrated (NAME: a task with a recording in rosbags/). Ends with `verdict: success` or `verdict: failure`.
#
#     launch_scripts/demo.sh [--headless] [--seed N] [--task NAME]
#
# Leaves models/TASK/report.html, runs/demo/ with a bag, an animated picture, logs and result.json.
set -euo pipefail

headless=false
seed=1
task=cup_on_coaster
while [ $# -gt 0 ]; do
    case "$1" in
    --headless) headless=true ;;
    --seed) seed=${2:?--seed needs a number}; shift ;;
    --task) task=${2:?--task needs a name}; shift ;;
    -h | --help) sed -n '2,/^set /p' "$0" | sed '$d; s/^# \{0,1\}//'; exit 0 ;;
    *) echo "demo: unknown argument $1 (see --help)" >&2; exit 2 ;;
    esac
    shift
done

# shellcheck source=launch_scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
cargo build --workspace --bins
bin=${CARGO_TARGET_DIR:-target}/debug

status=0
"$bin/tdv" demo --task "config/tasks/$task.yaml" --bag "rosbags/$task" --lab-seed "$seed" || status=$?
if ! $headless && command -v xdg-open >/dev/null && [ -n "${DISPLAY:-}" ]; then
    xdg-open "models/$task/report.html" || true
fi
exit $status
