#!/usr/bin/env bash
# All tests. Installs what they need, builds, runs; a second run skips what is there.
set -euo pipefail

# shellcheck source=launch_scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
# Tests across nodes run the programs; rclpy and rosbags stand beside them.
python3 -c 'import os, sysconfig; os.stat(sysconfig.get_path("include") + "/Python.h")' 2>/dev/null ||
    apt_install python3-dev
[ "$(id -u)" -ne 0 ] || have ip || apt_install iproute2
tests/peers/setup.sh target/peers
export TDV_PEERS=$root/target/peers
cargo build --workspace --bins --examples
cargo test --workspace
