#!/bin/bash
# Runs a command in a network of its own: a loopback device that can multicast, and nothing else.
# Everything that is to talk must run inside ONE call. Needs root; without it, the command runs in
# the normal network with discovery on this machine only and a domain picked by process number.
#
#   tests/peers/netns.sh bash my_check.sh
set -eu

if [ $# -eq 0 ]; then
  echo "usage: $0 COMMAND [ARGUMENT...]" >&2
  exit 2
fi
if [ "$(id -u)" -eq 0 ] && unshare -n true 2>/dev/null && command -v ip >/dev/null; then
  # shellcheck disable=SC2016
  exec unshare -n -- bash -c '
    ip link set lo up
    ip link set lo multicast on
    ip route add 224.0.0.0/4 dev lo
    exec "$@"' _ "$@"
fi
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export ROS_DOMAIN_ID=$((1 + $$ % 100))
exec "$@"
