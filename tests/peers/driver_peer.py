#!/usr/bin/env python3
"""Checks ur5_driver's ROS surface against the official driver's, as a peer on rclpy (ROS 2 Jazzy).

    source DIR/env.sh            (see setup.sh)
    tests/peers/netns.sh tests/peers/driver_peer.py target/debug

Starts virtual_lab and ur5_driver, compares names, types and QoS over discovery with the table below,
reads a message of each topic, and uses services and actions: states, controllers, motion with all its
ends, modes, gripper. One line a check; exit code 1 when one fails.
"""
import signal
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory, GripperCommand
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from control_msgs.srv import QueryTrajectoryState
from controller_manager_msgs.srv import ListControllers, SwitchController
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.action import ActionClient
from rclpy.duration import Duration as RclpyDuration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from ur_dashboard_msgs.action import SetMode
from ur_dashboard_msgs.msg import RobotMode, SafetyMode
from ur_dashboard_msgs.srv import (AddToLog, GetLoadedProgram, GetProgramState, GetRobotMode, GetRobotModel,
                                   GetSafetyMode, IsInRemoteControl, IsProgramRunning, Load, Popup, RawRequest)
from ur_msgs.msg import IOStates, ToolDataMsg
from ur_msgs.srv import SetAnalogOutput, SetIO, SetPayload, SetSpeedSliderFraction

REPO = Path(__file__).resolve().parents[2]
JTC = "/scaled_joint_trajectory_controller"
IO = "/io_and_status_controller"
JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
          "wrist_3_joint"]
# Name, type, latched: what the official driver publishes on Jazzy.
PUBLISHED = [
    ("/joint_states", JointState, False), ("/tcp_pose_broadcaster/pose", PoseStamped, False),
    ("/force_torque_sensor_broadcaster/wrench", WrenchStamped, False),
    ("/speed_scaling_state_broadcaster/speed_scaling", Float64, False),
    (f"{IO}/robot_mode", RobotMode, True), (f"{IO}/safety_mode", SafetyMode, True),
    (f"{IO}/robot_program_running", Bool, True), (f"{IO}/io_states", IOStates, False),
    (f"{IO}/tool_data", ToolDataMsg, False), (f"{JTC}/controller_state", JointTrajectoryControllerState, False),
    ("/tf", TFMessage, False), ("/tf_static", TFMessage, True), ("/robot_description", String, True),
]
SUBSCRIBED = [
    (f"{JTC}/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
    ("/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray"),
    ("/forward_velocity_controller/commands", "std_msgs/msg/Float64MultiArray"),
    ("/urscript_interface/script_command", "std_msgs/msg/String"),
]
TRIGGERS = ["power_on", "power_off", "brake_release", "play", "pause", "stop", "unlock_protective_stop",
            "restart_safety", "close_popup", "close_safety_popup", "shutdown", "quit", "connect",
            "clear_operational_mode"]
SERVICES = {
    f"{IO}/set_io": SetIO, f"{IO}/set_analog_output": SetAnalogOutput, f"{IO}/set_payload": SetPayload,
    f"{IO}/set_speed_slider": SetSpeedSliderFraction, f"{IO}/resend_robot_program": Trigger,
    f"{IO}/hand_back_control": Trigger, f"{IO}/zero_ftsensor": Trigger,
    f"{JTC}/query_state": QueryTrajectoryState,
    "/controller_manager/list_controllers": ListControllers,
    "/controller_manager/switch_controller": SwitchController,
    "/robotiq_activation_controller/reactivate_gripper": Trigger,
    "/dashboard_client/get_robot_mode": GetRobotMode, "/dashboard_client/get_safety_mode": GetSafetyMode,
    "/dashboard_client/program_running": IsProgramRunning, "/dashboard_client/program_state": GetProgramState,
    "/dashboard_client/get_loaded_program": GetLoadedProgram, "/dashboard_client/load_program": Load,
    "/dashboard_client/load_installation": Load, "/dashboard_client/popup": Popup,
    "/dashboard_client/add_to_log": AddToLog, "/dashboard_client/raw_request": RawRequest,
    "/dashboard_client/is_in_remote_control": IsInRemoteControl,
    "/dashboard_client/get_robot_model": GetRobotModel,
    **{f"/dashboard_client/{name}": Trigger for name in TRIGGERS},
}
failures = []


def check(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}", flush=True)
    if not good:
        failures.append(name)


def spin(node, seconds, until=lambda: False):
    end = time.monotonic() + seconds
    while time.monotonic() < end and not until():
        rclpy.spin_once(node, timeout_sec=0.02)
    return until()


def call(node, kind, name, request, patience=10.0):
    client = node.create_client(kind, name)
    if not client.wait_for_service(timeout_sec=patience):
        return None
    future = client.call_async(request)
    spin(node, patience, future.done)
    node.destroy_client(client)
    return future.result() if future.done() else None


class Robot:
    """What the topics say, and motions."""

    def __init__(self, node):
        self.node = node
        self.seen = {}
        for name, kind, latched in PUBLISHED:
            durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
            qos = QoSProfile(depth=5, durability=durability, reliability=ReliabilityPolicy.RELIABLE)
            node.create_subscription(kind, name, lambda m, n=name: self.seen.__setitem__(n, m), qos)
        self.follow = ActionClient(node, FollowJointTrajectory, f"{JTC}/follow_joint_trajectory")
        self.feedback = []

    def q(self):
        state = self.seen["/joint_states"]
        return [state.position[state.name.index(j)] for j in JOINTS]

    def trajectory(self, shift, seconds, names=None):
        point = JointTrajectoryPoint(velocities=[0.0] * 6)
        point.positions = [a + shift for a in self.q()]
        point.time_from_start = Duration(sec=int(seconds), nanosec=int(seconds % 1 * 1e9))
        return JointTrajectory(joint_names=names or JOINTS, points=[point])

    def send(self, trajectory, **fields):
        goal = FollowJointTrajectory.Goal(trajectory=trajectory, **fields)
        sent = self.follow.send_goal_async(goal, feedback_callback=self.feedback.append)
        spin(self.node, 5, sent.done)
        return sent.result()

    def end(self, handle, patience=15.0):
        result = handle.get_result_async()
        spin(self.node, patience, result.done)
        return result.result() if result.done() else None


def check_surface(node, robot):
    spin(node, 25, lambda: len(robot.seen) == len(PUBLISHED))
    types = dict(node.get_topic_names_and_types())
    for name, kind, latched in PUBLISHED:
        wanted = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        ends = [e for e in node.get_publishers_info_by_topic(name) if e.node_name == "ur5_driver"]
        check(f"{name} is {wanted}", types.get(name) == [wanted], types.get(name))
        qos = ends and ends[0].qos_profile
        good = qos and qos.reliability == ReliabilityPolicy.RELIABLE
        good = good and (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL) == latched
        check(f"{name} reliable{', latched' if latched else ''}", bool(good), ends)
        check(f"a message on {name}", name in robot.seen)
    for name, kind in SUBSCRIBED:
        ends = node.get_subscriptions_info_by_topic(name)
        check(f"{name} takes {kind}", any(e.topic_type == kind for e in ends), ends and ends[0].topic_type)
    offered = dict(node.get_service_names_and_types())
    for name, kind in SERVICES.items():
        wanted = f"{kind.__module__.split('.')[0]}/srv/{kind.__name__}"
        check(f"service {name}", offered.get(name) == [wanted], offered.get(name))


def check_states(node, robot):
    state = robot.seen["/joint_states"]
    check("joint_states in UR order", list(state.name[:6]) == JOINTS, state.name)
    check("robot runs", robot.seen[f"{IO}/robot_mode"].mode == RobotMode.RUNNING)
    check("safety is normal", robot.seen[f"{IO}/safety_mode"].mode == SafetyMode.NORMAL)
    # The servo program has been sent and answers.
    check("our program runs", spin(node, 20, lambda: robot.seen[f"{IO}/robot_program_running"].data))
    check("18 digital inputs", len(robot.seen[f"{IO}/io_states"].digital_in_states) == 18)
    check("the URDF names tool0", "tool0" in robot.seen["/robot_description"].data)


def check_motion(node, robot):
    check("action server", robot.follow.wait_for_server(timeout_sec=10))
    begin = robot.q()
    done = robot.end(robot.send(robot.trajectory(0.1, 1.5)))
    check("a goal succeeds", done and done.status == 4 and done.result.error_code == 0, done)
    off = max(abs(a - b - 0.1) for a, b in zip(robot.q(), begin))
    check("and the arm is there", off < 0.01, off)
    check("with feedback", len(robot.feedback) > 5, len(robot.feedback))
    handle = robot.send(robot.trajectory(0.1, 1.0, JOINTS[:5] + ["elbow"]))
    check("wrong joints are refused", not handle.accepted)
    check("an empty goal is refused", not robot.send(JointTrajectory(joint_names=JOINTS)).accepted)
    tight = [JointTolerance(name=j, position=0.001) for j in JOINTS]
    done = robot.end(robot.send(robot.trajectory(-0.2, 0.8), path_tolerance=tight))
    check("the path tolerance aborts", done and done.status == 6 and done.result.error_code == -4, done)
    first = robot.send(robot.trajectory(0.1, 3.0))
    second = robot.send(robot.trajectory(-0.05, 1.5))
    done = robot.end(first)
    # INVALID_GOAL is what the official controller gives to a goal that it drops for a newer one.
    check("a newer goal takes over", done and done.status == 6 and done.result.error_code == -1, done)
    check("and succeeds", (robot.end(second) or done).status == 4)
    begin = robot.q()
    handle = robot.send(robot.trajectory(0.2, 4.0))
    spin(node, 1.0)
    # Asked for a time after the trajectory's end: the end.
    later = (node.get_clock().now() + RclpyDuration(seconds=10)).to_msg()
    answer = call(node, QueryTrajectoryState, f"{JTC}/query_state", QueryTrajectoryState.Request(time=later))
    check("query_state knows the end", answer and answer.success and list(answer.name) == JOINTS
          and max(abs(a - b - 0.2) for a, b in zip(answer.position, begin)) < 1e-3, answer)
    cancel = handle.cancel_goal_async()
    spin(node, 5, cancel.done)
    done = robot.end(handle)
    check("a goal is canceled", done and done.status == 5, done)
    spin(node, 0.5)
    a = robot.q()
    spin(node, 0.5)
    check("and the arm rests", max(abs(x - y) for x, y in zip(a, robot.q())) < 1e-3)


def switch(node, on, off, strictness=SwitchController.Request.STRICT):
    request = SwitchController.Request(activate_controllers=on, deactivate_controllers=off, strictness=strictness)
    answer = call(node, SwitchController, "/controller_manager/switch_controller", request)
    return answer is not None and answer.ok


def check_controllers(node, robot):
    jtc, fpc, fvc = JTC[1:], "forward_position_controller", "forward_velocity_controller"
    found = call(node, ListControllers, "/controller_manager/list_controllers", ListControllers.Request())
    states = {c.name: c.state for c in found.controller} if found else {}
    check("controllers at the start", (states.get(jtc), states.get(fpc)) == ("active", "inactive"), states)
    check("an unknown one is refused", not switch(node, ["nobody"], [jtc]))
    check("two at a time are refused", not switch(node, [fpc], []))
    check("velocity takes over", switch(node, [fvc], [jtc]))
    check("goals are refused meanwhile", not robot.send(robot.trajectory(0.05, 1.0)).accepted)
    stream = node.create_publisher(Float64MultiArray, f"/{fvc}/commands", 1)
    spin(node, 1.0)
    before = robot.q()[0]
    for _ in range(25):
        stream.publish(Float64MultiArray(data=[0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
        spin(node, 0.02)
    check("a velocity moves the arm", robot.q()[0] - before > 0.03, robot.q()[0] - before)
    spin(node, 0.6)
    rest = robot.q()[0]
    spin(node, 0.5)
    check("without a fresh one it rests", abs(robot.q()[0] - rest) < 1e-3, robot.q()[0] - rest)
    check("trajectories take over", switch(node, [jtc], [fvc]))


def check_modes(node, robot):
    answer = call(node, GetRobotMode, "/dashboard_client/get_robot_mode", GetRobotMode.Request())
    check("dashboard: robot mode", answer and answer.success and answer.robot_mode.mode == 7, answer)
    answer = call(node, GetSafetyMode, "/dashboard_client/get_safety_mode", GetSafetyMode.Request())
    check("dashboard: safety mode", answer and answer.success and answer.safety_mode.mode == 1, answer)
    for fraction, good in [(0.0, False), (1.5, False), (0.5, True), (1.0, True)]:
        request = SetSpeedSliderFraction.Request(speed_slider_fraction=fraction)
        answer = call(node, SetSpeedSliderFraction, f"{IO}/set_speed_slider", request)
        check(f"slider at {fraction}: {'taken' if good else 'refused'}", answer and answer.success == good)
        if fraction == 0.5:
            scaling = "/speed_scaling_state_broadcaster/speed_scaling"
            check("and seen", spin(node, 3, lambda: abs(robot.seen[scaling].data - 50.0) < 1.0))
    stopped = call(node, Trigger, "/dashboard_client/stop", Trigger.Request())
    check("the program is stopped", stopped and stopped.success, stopped)
    running = f"{IO}/robot_program_running"
    check("and seen", spin(node, 5, lambda: not robot.seen[running].data))
    spin(node, 3)
    check("nobody starts it again", not robot.seen[running].data)
    client = ActionClient(node, SetMode, "/ur_robot_state_helper/set_mode")
    check("set_mode is served", client.wait_for_server(timeout_sec=10))
    goal = SetMode.Goal(target_robot_mode=7, stop_program=True, play_program=True)
    sent = client.send_goal_async(goal)
    spin(node, 5, sent.done)
    done = robot.end(sent.result(), 60)
    check("set_mode succeeds", done and done.result.success, done)
    check("the program runs again", spin(node, 20, lambda: robot.seen[running].data))
    sent = client.send_goal_async(SetMode.Goal(target_robot_mode=4))
    spin(node, 5, sent.done)
    check("mode 4 is refused", not sent.result().accepted)
    answer = call(node, Trigger, "/ur5_driver/reset", Trigger.Request())
    check("reset", answer and answer.success, answer)


def check_gripper(node, robot):
    client = ActionClient(node, GripperCommand, "/robotiq_gripper_controller/gripper_cmd")
    check("gripper is served", client.wait_for_server(timeout_sec=10))
    goal = GripperCommand.Goal()
    goal.command.position = 0.4
    goal.command.max_effort = 50.0
    sent = client.send_goal_async(goal)
    spin(node, 5, sent.done)
    done = robot.end(sent.result(), 10)
    check("it comes to its position", done and done.result.reached_goal, done)


def main():
    binaries = Path(sys.argv[1]).resolve()
    arguments = ["--ros-args", "--params-file", "config/ur5_driver.yaml",
                 "-p", "description_file:=config/robot/ur5.urdf"]
    processes = [
        subprocess.Popen([binaries / "virtual_lab", "--ros-args", "--params-file", "config/virtual_lab.yaml"],
                         cwd=REPO),
        subprocess.Popen([binaries / "ur5_driver", *arguments], cwd=REPO),
    ]
    rclpy.init()
    node = rclpy.create_node("driver_peer")
    robot = Robot(node)
    try:
        check_surface(node, robot)
        check_states(node, robot)
        check_motion(node, robot)
        check_controllers(node, robot)
        check_modes(node, robot)
        check_gripper(node, robot)
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(20)
        rclpy.shutdown()
    print(f"{len(failures)} failed: {failures}" if failures else "all good")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
