#!/usr/bin/env bash
# What demo.sh and test.sh need before they can build: a Rust toolchain, a C compiler, Python, the hand
# networks. Installs from Debian's packages and PyPI only what is missing; a second run skips it all.
# Sourced by the other scripts.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"

have() { command -v "$1" >/dev/null 2>&1; }

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    else
        have sudo || { echo "setup: need root or sudo for: $*" >&2; exit 1; }
        sudo "$@"
    fi
}

apt_install() {
    have apt-get || { echo "setup: this is not Debian; please install: $*" >&2; exit 1; }
    echo "setup: installing $*"
    as_root apt-get update -qq
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# Debian 12's newer Rust comes through its security archive, which a minimal root does not list.
add_security_archive() {
    grep -q '^VERSION_CODENAME=bookworm' /etc/os-release 2>/dev/null || return 0
    ! grep -rqs 'bookworm-security' /etc/apt/sources.list /etc/apt/sources.list.d || return 0
    echo "setup: adding Debian's security archive to apt's sources"
    echo "deb http://deb.debian.org/debian-security bookworm-security main" |
        as_root tee /etc/apt/sources.list.d/bookworm-security.list >/dev/null
}

# The workspace says which Rust it needs.
wanted=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml | head -1)
rust_suits() {
    have cargo && have rustc &&
        [ "$(printf '%s\n' "$wanted" "$(rustc --version | cut -d' ' -f2)" | sort -V | head -1)" = "$wanted" ]
}

missing=()
have cc || missing+=(gcc libc6-dev)
have c++ || missing+=(g++)
have python3 || missing+=(python3)
python3 -c 'import venv, ensurepip' 2>/dev/null || missing+=(python3-venv)
have git || missing+=(git)
[ ${#missing[@]} -eq 0 ] || apt_install "${missing[@]}" ca-certificates
if ! rust_suits; then
    add_security_archive
    apt_install rustc-web cargo-web
fi
rust_suits || { echo "setup: Rust $wanted or newer is needed; https://rustup.rs installs it" >&2; exit 1; }

# .cargo/config.toml asks for the instructions of 2013; an older processor gets the baseline.
if [ "$(uname -m)" = x86_64 ] && ! grep -qw avx2 /proc/cpuinfo; then
    export RUSTFLAGS="-C target-cpu=x86-64"
fi

"$root/launch_scripts/fetch_hand_models.sh"
