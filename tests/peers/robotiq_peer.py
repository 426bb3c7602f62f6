#!/usr/bin/env python3
"""Drives the virtual gripper with pyrobotiqur: activation, opening, closing, an object.

    source DIR/env.sh            (see setup.sh)
    tests/peers/netns.sh python tests/peers/robotiq_peer.py target/debug/examples/controller

One line a check; exit code 1 when one fails.
"""
import json
import subprocess
import sys
import time

from pyrobotiqur import RobotiqGripper
from pyrobotiqur.enums import GripperStatus, ObjectStatus

ADDRESS = "127.0.0.1"
failures = []


def check(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}", flush=True)
    if not good:
        failures.append(name)


def main(program):
    lab = subprocess.Popen([program, ADDRESS], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    if lab.stdout.readline().strip() != "ready":
        sys.exit("the controller does not start")

    def say(line):
        lab.stdin.write(line + "\n")
        lab.stdin.flush()

    def gap():
        say("state")
        return json.loads(lab.stdout.readline())["gap"]

    try:
        with RobotiqGripper(ADDRESS) as gripper:
            check("it is not active at first", gripper.get_status() == GripperStatus.RESET)
            gripper.activate()
            check("activated", gripper.get_status() == GripperStatus.ACTIVE and gripper.get_fault() == 0)
            for name, value in [("ACT", 1), ("ATR", 0), ("ARD", 0), ("MOD", 0), ("SID", 9), ("FLT", 0)]:
                check(f"{name} is {value}", gripper.get_var(name) == value)

            position, seen = gripper.close(speed=255, force=50)
            check("closed on nothing", seen == ObjectStatus.AT_DEST and position == 230 and gap() < 0.002,
                  f"{position}, {gap() * 1e3:.1f} mm")
            check("the request is echoed", gripper.get_requested_position() == 255 and gripper.get_var("PCO") == 255)
            position, seen = gripper.open(speed=255)
            check("opened", seen == ObjectStatus.AT_DEST and position == 3 and gap() > 0.084)

            say("object 0.05")
            position, seen = gripper.close(speed=128, force=20)
            check("an object is felt", seen == ObjectStatus.STOPPED_INNER_OBJECT and abs(gap() - 0.05) < 1e-6,
                  f"{position}, {gap() * 1e3:.1f} mm")
            say("object none")
            time.sleep(1.0)
            check("an object that is pulled out is missed", gripper.get_object_status() == ObjectStatus.AT_DEST)
            for percent, position in [(0, 3), (50, 128)]:
                got, seen = gripper.move_percent(percent, speed=255)
                check(f"{percent} percent", seen == ObjectStatus.AT_DEST and abs(got - position) <= 1, got)

            began = time.monotonic()
            gripper.close(speed=0)
            slow = time.monotonic() - began
            gripper.open(speed=255)
            began = time.monotonic()
            gripper.close(speed=255)
            fast = time.monotonic() - began
            check("speed counts", slow > 2.0 * fast, f"{slow:.2f} s and {fast:.2f} s")
            gripper.reset()
            check("reset", gripper.get_status() == GripperStatus.RESET)
            gripper.set_var("GTO", 1)
            time.sleep(0.1)
            check("a move without activation is a fault", gripper.get_fault() == 7)
    finally:
        lab.stdin.close()
        lab.wait(10)


if __name__ == "__main__":
    main(sys.argv[1])
    sys.exit(1 if failures else 0)
