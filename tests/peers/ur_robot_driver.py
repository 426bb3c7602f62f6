#!/usr/bin/env python3
"""Imitates the ROS surface of ur_robot_driver (Jazzy) and of the Robotiq driver, for swap tests.

    source DIR/env.sh                       (see setup.sh)
    tests/peers/ur_robot_driver.py --robot-ip 127.0.0.1

Everything below the surface is other people's: ur_rtde moves the arm (servoJ), the gripper is asked
over its URCap socket. Names, types and QoS are those of the official drivers; joint states come in
alphabetical order and the gripper's in a message of their own, as in many releases.

The joint trajectory controller follows ros2_controllers: it is inactive until switch_controller
activates it; a new trajectory replaces the old one at once; before its first point the set point runs
from the MEASURED state to it; between points the spline is linear, cubic or quintic by what the points
carry; past the end the last point is held; time is stretched by the speed scaling. Trajectories that
break its rules are refused, and counted: the count is printed at the end.
"""
import argparse
import math
import signal
import socket
import threading
import time

import rclpy
from control_msgs.action import GripperCommand
from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import ListControllers, SwitchController
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from trajectory_msgs.msg import JointTrajectory
from ur_dashboard_msgs.msg import RobotMode, SafetyMode

JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
          "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
KNUCKLE = "robotiq_85_left_knuckle_joint"
JTC = "scaled_joint_trajectory_controller"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL,
                     reliability=ReliabilityPolicy.RELIABLE)
# The official driver's servoj settings.
LOOKAHEAD, GAIN = 0.03, 2000
PATH_TOLERANCE = 0.2  # rad, the official configuration's
CLOSED, LOW, HIGH = 0.7929, 3, 230


def seconds(stamp):
    return stamp.sec + 1e-9 * stamp.nanosec


class Refused(Exception):
    """A trajectory that the controller does not take."""


class Trajectory:
    """One accepted message, times in seconds of the controller's own clock."""

    def __init__(self, message, now, measured):
        self.order = check(message)
        start = seconds(message.header.stamp) or now
        self.points = []
        for p in message.points:
            pick = lambda v: [v[i] for i in self.order] if v else None
            self.points.append((start + seconds(p.time_from_start), pick(p.positions),
                                pick(p.velocities), pick(p.accelerations)))
        if self.points[-1][0] < now:
            raise Refused(f"ends {now - self.points[-1][0]:.3f} s in the past")
        q, qd = measured
        self.before = (now, list(q), list(qd), None)

    def sample(self, t):
        """Positions and velocities wanted at time t."""
        first, last = self.points[0], self.points[-1]
        if t >= last[0]:
            return last[1], [0.0] * 6
        if t < first[0]:
            return spline(self.before, first, t)
        for a, b in zip(self.points, self.points[1:]):
            if a[0] <= t < b[0]:
                return spline(a, b, t)
        return last[1], [0.0] * 6


def check(message):
    """The order of the arm's joints in the message; raises Refused by the controller's rules."""
    if sorted(message.joint_names) != sorted(JOINTS):
        raise Refused(f"joints {list(message.joint_names)}")
    if not message.points:
        raise Refused("no points")
    before = -1.0
    for i, p in enumerate(message.points):
        t = seconds(p.time_from_start)
        if t <= before:
            raise Refused(f"time {t} of point {i} is not after {before}")
        before = t
        for name, v, needed in [("positions", p.positions, True), ("velocities", p.velocities, False),
                                ("accelerations", p.accelerations, False)]:
            if len(v) != 6 and (needed or len(v) != 0):
                raise Refused(f"{len(v)} {name} in point {i}")
            if not all(math.isfinite(x) for x in v):
                raise Refused(f"{name} of point {i} are not finite")
        if len(p.effort):
            raise Refused(f"effort in point {i}")
    if any(abs(v) > 1e-7 for v in message.points[-1].velocities):
        raise Refused("the last point moves")
    return [list(message.joint_names).index(j) for j in JOINTS]


def spline(a, b, t):
    """Between two points (time, q, qd, qdd): linear, cubic or quintic by what both have."""
    span, x = b[0] - a[0], t - a[0]
    if span <= 0.0:
        return b[1], b[2] or [0.0] * 6
    q, qd = [], []
    for i in range(6):
        p0, p1 = a[1][i], b[1][i]
        if a[2] is None or b[2] is None:
            q.append(p0 + (p1 - p0) * x / span)
            qd.append((p1 - p0) / span)
            continue
        v0, v1 = a[2][i], b[2][i]
        if a[3] is None or b[3] is None:
            c2 = (3 * (p1 - p0) - (2 * v0 + v1) * span) / span**2
            c3 = (2 * (p0 - p1) + (v0 + v1) * span) / span**3
            q.append(p0 + v0 * x + c2 * x**2 + c3 * x**3)
            qd.append(v0 + 2 * c2 * x + 3 * c3 * x**2)
            continue
        w0, w1 = a[3][i], b[3][i]
        d = p1 - p0
        c3 = (20 * d - (8 * v1 + 12 * v0) * span - (3 * w0 - w1) * span**2) / (2 * span**3)
        c4 = (-30 * d + (14 * v1 + 16 * v0) * span + (3 * w0 - 2 * w1) * span**2) / (2 * span**4)
        c5 = (12 * d - 6 * (v1 + v0) * span + (w1 - w0) * span**2) / (2 * span**5)
        q.append(p0 + v0 * x + 0.5 * w0 * x**2 + c3 * x**3 + c4 * x**4 + c5 * x**5)
        qd.append(v0 + w0 * x + 3 * c3 * x**2 + 4 * c4 * x**3 + 5 * c5 * x**4)
    return q, qd


class Gripper:
    """The URCap's socket."""

    def __init__(self, address):
        self.lock = threading.Lock()
        self.socket = socket.create_connection((address, 63352), timeout=2.0)
        if self.get("STA") != 3:
            self.set("ACT", 0)
            while self.get("STA") != 0:
                time.sleep(0.05)
            self.set("ACT", 1)
            while self.get("STA") != 3:
                time.sleep(0.05)

    def ask(self, line):
        with self.lock:
            self.socket.sendall(line.encode() + b"\n")
            return self.socket.recv(64).decode().strip()

    def get(self, name):
        return int(self.ask(f"GET {name}").split()[1])

    def set(self, *pairs):
        words = " ".join(str(w) for w in pairs)
        assert self.ask(f"SET {words}") == "ack", words

    def angle(self):
        return CLOSED * (min(max(self.get("POS"), LOW), HIGH) - LOW) / (HIGH - LOW)


class Driver(Node):
    """Arm and gripper behind the official names."""

    def __init__(self, address):
        super().__init__("ur_robot_driver_imitation")
        self.receive = RTDEReceiveInterface(address)
        self.control = RTDEControlInterface(address)
        self.gripper = Gripper(address)
        self.active = {JTC: False, "forward_position_controller": False}
        self.trajectory = None
        self.time = time.monotonic()
        self.refused = 0
        self.unheard = 0
        self.violations = 0
        group = ReentrantCallbackGroup()
        self.joints = self.create_publisher(JointState, "/joint_states", 10)
        self.pose = self.create_publisher(PoseStamped, "/tcp_pose_broadcaster/pose", 10)
        self.scaling = self.create_publisher(
            Float64, "/speed_scaling_state_broadcaster/speed_scaling", 10)
        latched = [(RobotMode, "robot_mode", RobotMode(mode=7)),
                   (SafetyMode, "safety_mode", SafetyMode(mode=1)),
                   (Bool, "robot_program_running", Bool(data=True))]
        for kind, name, value in latched:
            p = self.create_publisher(kind, f"/io_and_status_controller/{name}", LATCHED)
            p.publish(value)
            setattr(self, name, p)
        self.create_subscription(JointTrajectory, f"/{JTC}/joint_trajectory", self.on_trajectory, 10,
                                 callback_group=group)
        self.create_service(ListControllers, "/controller_manager/list_controllers", self.on_list,
                            callback_group=group)
        self.create_service(SwitchController, "/controller_manager/switch_controller", self.on_switch,
                            callback_group=group)
        ActionServer(self, GripperCommand, "/robotiq_gripper_controller/gripper_cmd", self.on_grip,
                     callback_group=group, cancel_callback=lambda _: CancelResponse.ACCEPT)
        self.running = True
        self.thread = threading.Thread(target=self.loop)
        self.thread.start()
        self.watch = threading.Thread(target=self.watch_gripper)
        self.watch.start()

    def on_list(self, _request, response):
        for name, active in self.active.items():
            interfaces = [f"{j}/position" for j in JOINTS]
            response.controller.append(ControllerState(
                name=name, state="active" if active else "inactive",
                type="ur_controllers/ScaledJointTrajectoryController",
                claimed_interfaces=interfaces if active else [],
                required_command_interfaces=interfaces))
        return response

    def on_switch(self, request, response):
        names = list(request.activate_controllers) + list(request.deactivate_controllers)
        after = dict(self.active)
        after.update({n: False for n in request.deactivate_controllers})
        after.update({n: True for n in request.activate_controllers})
        response.ok = all(n in self.active for n in names) and sum(after.values()) <= 1
        if response.ok:
            self.active = after
            self.trajectory = None
        self.get_logger().info(f"switch {names}: {response.ok}")
        return response

    def on_trajectory(self, message):
        if not self.active[JTC]:
            self.unheard += 1
            return
        now = self.clock_now() if seconds(message.header.stamp) else self.time
        try:
            measured = (self.receive.getActualQ(), self.receive.getActualQd())
            new = Trajectory(message, now, measured)
            if seconds(message.header.stamp):
                shift = self.time - now
                new.points = [(t + shift, *rest) for t, *rest in new.points]
                new.before = (self.time, *new.before[1:])
            self.trajectory = new
        except Refused as why:
            self.refused += 1
            self.get_logger().warn(f"trajectory refused: {why}")

    def clock_now(self):
        return self.get_clock().now().nanoseconds * 1e-9

    def loop(self):
        """The control cycle at 125 Hz."""
        hold = self.receive.getActualQ()
        period = 0.008
        due = time.monotonic()
        while self.running:
            due = max(due + period, time.monotonic() - period)
            time.sleep(max(0.0, due - time.monotonic()))
            q, qd = self.receive.getActualQ(), self.receive.getActualQd()
            self.publish_state(q, qd)
            self.time += period * self.factor()
            trajectory = self.trajectory
            if trajectory is not None:
                hold, _ = trajectory.sample(self.time)
                if max(abs(a - b) for a, b in zip(hold, q)) > PATH_TOLERANCE:
                    self.violations += 1
                    self.get_logger().warn("holding position due to state tolerance violation")
                    hold, self.trajectory = q, None
            if any(self.active.values()):
                self.control.servoJ(list(hold), 0.0, 0.0, period, LOOKAHEAD, GAIN)
            else:
                hold = q
        self.control.servoStop()
        self.control.stopScript()

    def factor(self):
        return min(1.0, self.receive.getSpeedScaling() * self.receive.getTargetSpeedFraction())

    def publish_state(self, q, qd):
        now = self.get_clock().now().to_msg()
        message = JointState()
        message.header.stamp = now
        message.header.frame_id = "base_link"
        for i in sorted(range(6), key=lambda i: JOINTS[i]):
            message.name.append(JOINTS[i])
            message.position.append(q[i])
            message.velocity.append(qd[i])
            message.effort.append(float("nan"))
        self.joints.publish(message)
        pose = PoseStamped()
        pose.header.stamp = now
        pose.header.frame_id = "base"
        x, y, z, *turn = self.receive.getActualTCPPose()
        angle = math.sqrt(sum(v * v for v in turn))
        share = math.sin(angle / 2) / angle if angle > 1e-9 else 0.5
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = x, y, z
        o = pose.pose.orientation
        o.x, o.y, o.z = (v * share for v in turn)
        o.w = math.cos(angle / 2)
        self.pose.publish(pose)
        self.scaling.publish(Float64(data=100.0 * self.factor()))

    def watch_gripper(self):
        while self.running:
            message = JointState()
            message.header.stamp = self.get_clock().now().to_msg()
            message.name = [KNUCKLE]
            message.position = [self.gripper.angle()]
            self.joints.publish(message)
            time.sleep(0.03)

    def on_grip(self, handle):
        goal = handle.request.command
        register = LOW + round(max(0.0, min(1.0, goal.position / CLOSED)) * (HIGH - LOW))
        self.gripper.set("POS", register, "SPE", 255, "FOR", 40, "GTO", 1)
        while self.gripper.get("PRE") != register:
            time.sleep(0.01)
        while self.running and (state := self.gripper.get("OBJ")) == 0:
            time.sleep(0.02)
        result = GripperCommand.Result()
        result.position = self.gripper.angle()
        result.stalled = state in (1, 2)
        result.reached_goal = state == 3
        handle.succeed()
        return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot-ip", default="127.0.0.1")
    arguments, rest = parser.parse_known_args()
    # The robot may come up later than this.
    end = time.monotonic() + 15.0
    while True:
        try:
            socket.create_connection((arguments.robot_ip, 30004), timeout=1.0).close()
            break
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)
    rclpy.init(args=rest)
    node = Driver(arguments.robot_ip)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    signal.signal(signal.SIGTERM, lambda *_: rclpy.try_shutdown())
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    node.running = False
    node.thread.join(2.0)
    node.watch.join(2.0)
    print(f"{node.refused} trajectories refused, {node.unheard} came while inactive, "
          f"{node.violations} violations of the path tolerance", flush=True)


if __name__ == "__main__":
    main()
