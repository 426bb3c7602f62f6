#!/usr/bin/env python3
"""Our Modbus RTU against others over a pty: a slave with a 2F-85's registers is first driven by the
Python package `robotiq2f` (which shows that the slave is right), then by ur5_driver.

    source DIR/env.sh            (see setup.sh)
    tests/peers/netns.sh python tests/peers/modbus_peer.py target/debug/ur5_driver

With rclpy at hand (see setup.sh) a goal is sent to the driver's gripper action too. One line a check;
exit code 1 when one fails.
"""
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty

failures = []


def check(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}", flush=True)
    if not good:
        failures.append(name)


def crc(data):
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value.to_bytes(2, "little")


class Gripper(threading.Thread):
    """Slave 9 with the registers of a 2F-85; its fingers need a while."""

    def __init__(self):
        super().__init__(daemon=True)
        self.line, self.device = os.openpty()
        tty.setraw(self.line)
        tty.setraw(self.device)
        self.path = os.ttyname(self.device)
        self.out = [0, 0, 0]
        self.position = 3.0
        self.activated_at = None
        self.requests = []
        self.bad = 0
        self.disturb = 0

    def activation(self):
        if not self.out[0] >> 8 & 1:
            return 0
        return 3 if time.monotonic() - self.activated_at > 0.3 else 1

    def status(self):
        wanted = min(max(self.out[1] & 0xFF, 3), 230)
        moving = self.out[0] >> 11 & 1 and self.activation() == 3
        if moving:
            step = 6.0
            self.position += min(max(wanted - self.position, -step), step)
        there = abs(self.position - wanted) < 0.5
        obj = 3 if moving and there else 0
        head = self.out[0] >> 8 & 0x09 | self.activation() << 4 | obj << 6
        return [head << 8, self.out[1] & 0xFF, round(self.position) << 8]

    def answer(self, frame):
        function, at = frame[1], int.from_bytes(frame[2:4], "big")
        if function == 16:
            count = int.from_bytes(frame[4:6], "big")
            if not 0x03E8 <= at or at + count > 0x03EB:
                return bytes([9, 0x90, 2])
            for i in range(count):
                self.out[at - 0x03E8 + i] = int.from_bytes(frame[7 + 2 * i:9 + 2 * i], "big")
            if at == 0x03E8:
                self.activated_at = (self.activated_at or time.monotonic()) if self.out[0] >> 8 & 1 else None
            return bytes(frame[:6])
        count = int.from_bytes(frame[4:6], "big")
        values = self.status()[at - 0x07D0:at - 0x07D0 + count]
        return bytes([9, function, 2 * len(values)]) + b"".join(v.to_bytes(2, "big") for v in values)

    def run(self):
        data = b""
        while True:
            ready = select.select([self.line], [], [], 0.01)[0]
            if not ready:
                data = b""
                continue
            data += os.read(self.line, 256)
            while len(data) >= 8:
                size = 9 + data[6] if data[1] == 16 else 8
                if len(data) < size:
                    break
                frame, data = data[:size], data[size:]
                if crc(frame[:-2]) != frame[-2:] or frame[0] != 9:
                    self.bad += 1
                    data = b""
                    break
                self.requests.append(frame)
                reply = self.answer(frame)
                reply += crc(reply)
                if self.disturb:
                    self.disturb -= 1
                    reply = reply[:2] + bytes([reply[2] ^ 1]) + reply[3:]
                os.write(self.line, reply)


def wait(condition, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end and not condition():
        time.sleep(0.02)
    return condition()


def by_robotiq2f():
    import robotiq2f.robotiq2f as other
    gripper = Gripper()
    gripper.start()
    other.LinuxFindTTYWithSerialNumber.find = lambda self, number: gripper.path
    with other.Robotiq2F85("any", async_control=False) as client:
        client.activate()
        check("robotiq2f activates the slave", gripper.activation() == 3)
        client.client.write_registers(1000, [0x0900, 0x0080, 0xFF40])
        check("robotiq2f moves it", wait(lambda: abs(client.read_status_sync().opening - 39.8) < 1.0, 5))
    check("every frame of robotiq2f was whole", gripper.bad == 0, gripper.bad)


def by_the_driver(binary):
    gripper = Gripper()
    gripper.start()
    with tempfile.TemporaryDirectory() as folder:
        parameters = os.path.join(folder, "p.yaml")
        with open(parameters, "w") as file:
            file.write(f"ur5_driver:\n  ros__parameters:\n    gripper_device: {gripper.path}\n"
                       "    robot_ip: 127.0.0.9\n")
        process = subprocess.Popen([binary, "--ros-args", "--params-file", parameters])
        try:
            check("the driver activates it", wait(lambda: gripper.activation() == 3, 20))
            begin = len(gripper.requests)
            check("and goes on polling", wait(lambda: len(gripper.requests) > begin + 20, 5))
            writes = [f for f in gripper.requests if f[1] == 16]
            check("reset comes before activation",
                  [f[7] for f in writes[:2]] == [0, 1], [f.hex() for f in writes[:3]])
            gripper.disturb = 1
            begin = len(gripper.requests)
            check("a disturbed reply is asked for again", wait(lambda: len(gripper.requests) > begin + 20, 5))
            check("without a new activation", len([f for f in gripper.requests if f[1] == 16]) == len(writes))
            check("every frame of the driver was whole", gripper.bad == 0, gripper.bad)
            try:
                import rclpy  # noqa: F401
            except ImportError:
                print("skip the action: no rclpy")
            else:
                by_action(gripper)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(20)


def by_action(gripper):
    import rclpy
    from control_msgs.action import GripperCommand
    from rclpy.action import ActionClient
    rclpy.init()
    node = rclpy.create_node("modbus_peer")
    client = ActionClient(node, GripperCommand, "/robotiq_gripper_controller/gripper_cmd")
    check("the gripper's action", client.wait_for_server(timeout_sec=15))
    goal = GripperCommand.Goal()
    goal.command.position = 0.7929
    sent = client.send_goal_async(goal)
    rclpy.spin_until_future_complete(node, sent, timeout_sec=5)
    result = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, result, timeout_sec=10)
    done = result.result()
    check("the goal is reached", done and done.result.reached_goal, done)
    check("the fingers are closed", abs(gripper.position - 230) < 2, gripper.position)
    rclpy.shutdown()


if __name__ == "__main__":
    by_robotiq2f()
    by_the_driver(sys.argv[1])
    print(f"{len(failures)} failed: {failures}" if failures else "all good")
    sys.exit(1 if failures else 0)
