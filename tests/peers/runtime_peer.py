#!/usr/bin/env python3
"""Checks the runtime's example `peer` against rclpy (ROS 2 Jazzy, Fast DDS).

    source DIR/env.sh            (see setup.sh)
    tests/peers/netns.sh tests/peers/runtime_peer.py target/debug/examples/peer

Prints one line a check; exit code 1 when one fails.
"""
import os
import signal
import subprocess
import sys
import time

import rclpy
from control_msgs.action import GripperCommand
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient, ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from tdv_msgs.msg import PoseTrajectory
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3DArray

LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL,
                     reliability=ReliabilityPolicy.RELIABLE)
failures = []


def check(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}", flush=True)
    if not good:
        failures.append(name)


class Python(Node):
    """The other side: collects messages, serves a service and an action."""

    def __init__(self):
        super().__init__("python")
        self.seen = {}
        self.group = ReentrantCallbackGroup()
        self.create_service(SetBool, "/python/set", self.on_set)
        self.server = ActionServer(self, GripperCommand, "/python/gripper_cmd", self.on_goal,
                                   callback_group=self.group)
        self.latched = self.create_publisher(String, "/peer_latched", LATCHED)
        self.latched.publish(String(data="kept"))

    def on_set(self, request, response):
        response.success = request.data
        response.message = "set"
        return response

    def on_goal(self, handle):
        for i in range(3):
            handle.publish_feedback(GripperCommand.Feedback(position=0.1 * (i + 1)))
            time.sleep(0.05)
        handle.succeed()
        return GripperCommand.Result(position=handle.request.command.position, reached_goal=True)

    def listen(self, kind, topic, qos=32):
        self.seen[topic] = []
        # Not a bound append: the list is looked up by topic.
        self.create_subscription(kind, topic, lambda m: self.seen[topic].append(m), qos)


def main():
    program = sys.argv[1]
    rclpy.init()
    node = Python()
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)

    def until(condition, seconds=15.0):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not condition():
            executor.spin_once(timeout_sec=0.05)
        return condition()

    def result(future, seconds=15.0):
        until(future.done, seconds)
        return future.result() if future.done() else None

    rust = subprocess.Popen([program, "--ros-args", "-r", "__ns:=/tdv", "-p", "images:=true",
                             "-p", "call:=true", "-p", "publish_clock:=true",
                             "-p", "label:=first"])
    try:
        run(node, until, result)
        rust.send_signal(signal.SIGTERM)
        started = time.monotonic()
        code = rust.wait(timeout=10)
        check("SIGTERM ends it with exit code 0", code == 0, f"{code} in {time.monotonic() - started:.2f} s")
        check("the node has left the graph",
              until(lambda: ("peer", "/tdv") not in node.get_node_names_and_namespaces(), 5))
        check("its topics have left the graph",
              until(lambda: not node.get_publishers_info_by_topic("/tdv/peer/plan"), 5))
    finally:
        if rust.poll() is None:
            rust.kill()
    simulated(node, until, program)
    node.destroy_node()
    print(f"{len(failures)} failed" if failures else "all passed")
    # Skips rclpy's tear-down, which may hang on daemon threads of the executor.
    sys.stdout.flush()
    os._exit(1 if failures else 0)


def run(node, until, result):
    check("node is listed", until(lambda: ("peer", "/tdv") in node.get_node_names_and_namespaces()))

    node.listen(String, "/tdv/peer/latched", LATCHED)
    check("latched text from Rust", until(lambda: node.seen["/tdv/peer/latched"]))
    check("its content", [m.data for m in node.seen["/tdv/peer/latched"]] == ["first"])
    node.listen(TFMessage, "/tf_static", LATCHED)
    check("tf_static", until(lambda: node.seen["/tf_static"]))
    transform = node.seen["/tf_static"][0].transforms[0]
    check("its numbers", transform.child_frame_id == "camera"
          and abs(transform.transform.translation.x - 0.95) < 1e-12
          and abs(transform.transform.rotation.z - 0.479425538604203) < 1e-12)
    node.listen(String, "/tdv/peer/heard_latched", LATCHED)
    check("latched text to Rust", until(lambda: node.seen["/tdv/peer/heard_latched"]))

    node.listen(String, "/tdv/peer/echo")
    chatter = node.create_publisher(String, "/tdv/peer/chatter", 32)
    check("subscription of Rust is seen", until(lambda: chatter.get_subscription_count() == 1))
    until(lambda: False, 0.3)
    for i in range(20):
        chatter.publish(String(data=str(i)))
    check("20 of 20 echoed", until(lambda: len(node.seen["/tdv/peer/echo"]) == 20))
    check("in order", [m.data for m in node.seen["/tdv/peer/echo"]] == [f"heard {i}" for i in range(20)])

    node.listen(PoseTrajectory, "/tdv/peer/plan")
    check("tdv_msgs/PoseTrajectory", until(lambda: node.seen["/tdv/peer/plan"]))
    plan = node.seen["/tdv/peer/plan"][0]
    check("its content", plan.moving == "mug" and plan.procedure == 1 and len(plan.poses) == 16
          and plan.poses[15].orientation.w == 1.0 and plan.dt == 0.05)
    node.listen(Detection3DArray, "/tdv/peer/detections")
    check("vision_msgs/Detection3DArray", until(lambda: node.seen["/tdv/peer/detections"]))
    node.listen(DiagnosticArray, "/diagnostics")
    check("diagnostics", until(lambda: node.seen["/diagnostics"]))
    status = node.seen["/diagnostics"][-1].status[0]
    check("their content", status.name == "tdv/peer" and status.message == "all there"
          and any(v.key == "cpu_seconds" for v in status.values))
    node.listen(Log, "/rosout", QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    node.listen(JointState, "/joint_states")
    until(lambda: len(node.seen["/joint_states"]) > 0)
    before = len(node.seen["/joint_states"])
    started = time.monotonic()
    until(lambda: False, 2.0)
    rate = (len(node.seen["/joint_states"]) - before) / (time.monotonic() - started)
    numbers = [m.position[0] for m in node.seen["/joint_states"]]
    gaps = sum(b - a != 1 for a, b in zip(numbers, numbers[1:]))
    check("joint states without gaps", gaps == 0 and len(numbers) > 20, f"{rate:.0f} Hz, {gaps} gaps")

    node.listen(Image, "/camera/color/image_raw", qos_profile_sensor_data)
    node.listen(Image, "/camera/depth/image_raw", qos_profile_sensor_data)
    check("images", until(lambda: node.seen["/camera/color/image_raw"] and node.seen["/camera/depth/image_raw"]))
    color = node.seen["/camera/color/image_raw"][0]
    check("colour content", (color.width, color.height, color.encoding, color.step) == (640, 480, "rgb8", 1920)
          and bytes(color.data[3 * 641:3 * 642]) == bytes([1, 1, 7]))
    depth = node.seen["/camera/depth/image_raw"][0]
    check("depth content", depth.encoding == "16UC1"
          and int.from_bytes(bytes(depth.data[2 * 1234:2 * 1235]), "little") == 1234)

    services(node, until, result)
    parameters(node, until, result)
    actions(node, until, result)
    check("rosout", until(lambda: any("parameter" in m.msg for m in node.seen["/rosout"])),
          str(len(node.seen["/rosout"])))
    node.listen(String, "/tdv/peer/report", LATCHED)
    check("service and action called from Rust", until(lambda: node.seen["/tdv/peer/report"]))
    if node.seen["/tdv/peer/report"]:
        check("their results", node.seen["/tdv/peer/report"][0].data.startswith("true set Succeeded 0.40 Some(0.1"),
              node.seen["/tdv/peer/report"][0].data)
    types = dict(node.get_topic_names_and_types())
    check("/clock has one type", types.get("/clock") == ["rosgraph_msgs/msg/Clock"], str(types.get("/clock")))


def services(node, until, result):
    client = node.create_client(Trigger, "/tdv/peer/greet")
    check("service is seen", client.wait_for_service(10.0))
    answers = [result(client.call_async(Trigger.Request())) for _ in range(20)]
    check("20 of 20 calls answered", all(a is not None and a.success and a.message == "hello" for a in answers))


def parameters(node, until, result):
    clients = {k.__name__: node.create_client(k, f"/tdv/peer/{n}") for k, n in [
        (GetParameters, "get_parameters"), (SetParameters, "set_parameters"),
        (ListParameters, "list_parameters"), (DescribeParameters, "describe_parameters")]}
    check("parameter services", all(c.wait_for_service(10.0) for c in clients.values()))
    names = result(clients["ListParameters"].call_async(ListParameters.Request()))
    check("list", names is not None and set(names.result.names) == {
        "call", "gains", "images", "label", "limits.count", "publish_clock", "speed", "use_sim_time"},
        str(names and names.result.names))
    got = result(clients["GetParameters"].call_async(
        GetParameters.Request(names=["speed", "label", "limits.count", "gains", "nothing"])))
    check("get", got is not None and [got.values[0].double_value, got.values[1].string_value,
                                      got.values[2].integer_value, list(got.values[3].double_array_value),
                                      got.values[4].type] == [0.2, "first", 3, [1.0, 2.0], 0])

    def put(name, **value):
        request = SetParameters.Request(parameters=[Parameter(name=name, value=ParameterValue(**value))])
        answer = result(clients["SetParameters"].call_async(request))
        return (answer.results[0].successful, answer.results[0].reason) if answer else (None, "")

    double = ParameterType.PARAMETER_DOUBLE
    check("set", put("speed", type=double, double_value=0.1) == (True, ""))
    refused = put("speed", type=double, double_value=0.5)
    check("a bad value is refused with the reason", refused[0] is False and "at most 0.25" in refused[1], refused[1])
    refused = put("label", type=ParameterType.PARAMETER_STRING, string_value="x")
    check("a read-only one is refused", refused[0] is False and "read-only" in refused[1], refused[1])
    got = result(clients["GetParameters"].call_async(GetParameters.Request(names=["speed"])))
    check("the last good value stays", got is not None and got.values[0].double_value == 0.1)
    text = result(clients["DescribeParameters"].call_async(DescribeParameters.Request(names=["speed", "label"])))
    check("describe", text is not None and text.descriptors[0].description == "of the tool, m/s"
          and not text.descriptors[0].read_only and text.descriptors[1].read_only)


def actions(node, until, result):
    client = ActionClient(node, GripperCommand, "/tdv/peer/gripper_cmd")
    check("action server is seen", client.wait_for_server(10.0))
    feedback = []

    def send(position):
        goal = GripperCommand.Goal()
        goal.command.position = position
        return result(client.send_goal_async(goal, lambda m: feedback.append(m.feedback.position)))

    handle = send(0.5)
    check("goal accepted", handle is not None and handle.accepted)
    end = result(handle.get_result_async())
    check("goal succeeded", end is not None and end.status == 4 and end.result.reached_goal
          and abs(end.result.position - 0.5) < 1e-12, str(end and end.status))
    check("feedback", len(feedback) >= 9, str(len(feedback)))
    late = result(handle.get_result_async())
    check("the result can be asked for again", late is not None and late.status == 4)
    handle = send(5.0)
    check("goal rejected", handle is not None and not handle.accepted)
    handle = send(0.6)
    canceled = result(handle.cancel_goal_async())
    check("cancel accepted", canceled is not None and len(canceled.goals_canceling) == 1)
    end = result(handle.get_result_async())
    check("goal canceled", end is not None and end.status == 5, str(end and end.status))
    first, second = send(0.3), send(0.4)
    end = [result(h.get_result_async()) for h in (first, second)]
    check("a newer goal takes over", [e and e.status for e in end] == [6, 4], str([e and e.status for e in end]))


def simulated(node, until, program):
    clock = node.create_publisher(Clock, "/clock", 10)
    rust = subprocess.Popen([program, "--ros-args", "-r", "__node:=simulated", "-p", "use_sim_time:=true"])
    try:
        node.listen(PoseTrajectory, "/simulated/plan")
        stamp = [0]

        def tick():
            stamp[0] += 1
            message = Clock()
            message.clock.sec = 1000
            message.clock.nanosec = stamp[0]
            clock.publish(message)
            seen = node.seen["/simulated/plan"]
            return bool(seen) and seen[-1].header.stamp.sec == 1000

        check("use_sim_time follows /clock", until(tick))
    finally:
        rust.send_signal(signal.SIGINT)
        check("SIGINT ends it with exit code 0", rust.wait(timeout=10) == 0)


if __name__ == "__main__":
    main()
