#!/usr/bin/env bash
# All tests. Installs what they need, builds, runs; a second run skips what is there.
set -euo pipefail

# shellcheck source=launch_scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
cargo test --workspace
