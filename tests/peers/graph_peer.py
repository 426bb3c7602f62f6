#!/usr/bin/env python3
"""Checks the whole graph against rclpy (ROS 2 Jazzy, Fast DDS) and our bags against `rosbags`.

    source DIR/env.sh            (see setup.sh)
    tests/peers/netns.sh tests/peers/graph_peer.py target/debug models/cup_on_coaster

The closed loop runs beside rclpy: every node and every topic of the table in ARCHITECTURE.md with its
type, a message of each, parameters, a joint trajectory and a gripper goal. Then a bag of ours is read by
`rosbags`, and one written by `rosbags` is replayed by us. One line a check; exit code 1 when one fails.
"""
import collections
import importlib
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from control_msgs.action import GripperCommand
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

REPO = Path(__file__).resolve().parents[2]
LOOP = ["virtual_lab", "ur5_driver", "perception_bridge", "pose_tracker", "switch_policy",
        "diffusion_policy", "arm_controller"]
# What comes out of a recording instead of the lab.
REPLAY = ["camera_replay", "perception_bridge", "pose_tracker", "switch_policy", "diffusion_policy"]
TRUTH = "/virtual_lab/ground_truth/"
# Every ROS node has these; they are nobody's interface here.
COMMON = {"/parameter_events", "/rosout"}
# Seconds after which a replay begins, so that nothing of it is missed.
STARTUP_DELAY = 10.0
failures = []


def check(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}", flush=True)
    if not good:
        failures.append(name)


def table():
    """Topic -> (type, publishers, latched) out of ARCHITECTURE.md; actions are left out."""
    topics = {}
    for line in (REPO / "ARCHITECTURE.md").read_text().splitlines():
        cells = [c.strip() for c in line.strip().strip("|").split("|")]
        if len(cells) != 6 or not cells[0].startswith("/") or "/action/" in cells[1]:
            continue
        publishers = re.findall(r"[a-z_0-9]+", cells[2].replace("every node", "every"))
        topics[cells[0]] = (cells[1].split(" ")[0], publishers, cells[3] == "latched")
    return topics


def message_class(name):
    package, kind, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), message)


class Graph:
    """A launched graph; leaving it ends all its processes."""

    def __init__(self, binaries, *arguments):
        self.process = subprocess.Popen([str(binaries / "tdv"), "launch", *arguments], cwd=REPO)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            check("the graph ends when asked", False)


def spin(node, seconds, until=lambda: False):
    end = time.monotonic() + seconds
    while time.monotonic() < end and not until():
        rclpy.spin_once(node, timeout_sec=0.02)
    return until()


def call(node, kind, name, request, patience=5.0):
    client = node.create_client(kind, name)
    if not client.wait_for_service(patience):
        return None
    future = client.call_async(request)
    spin(node, patience, future.done)
    node.destroy_client(client)
    return future.result() if future.done() else None


def subscribe_all(node, topics, seen):
    for name, (kind, _, latched) in topics.items():
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        reliability = ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=5, durability=durability, reliability=reliability)

        def keep(message, name=name):
            seen[name].append(message)

        node.create_subscription(message_class(kind), name, keep, qos)


def check_graph(node, topics, names, seen, phase, recorded=()):
    """Nodes, topics, types, publishers and messages of what these nodes publish."""
    mine = {t: v for t, v in topics.items() if set(v[1]) & set(names) or "every" in v[1]}
    # A replay has the topics of its bag, and the clock.
    played = set(recorded) | {"/clock"}
    mine = {t: v for t, v in mine.items() if "camera_replay" not in v[1] or not recorded or t in played}

    spin(node, 25.0, lambda: all(seen[t] for t in mine))

    def nodes_seen():
        return {n for n, _ in node.get_node_names_and_namespaces()}

    spin(node, 15.0, lambda: set(names) <= nodes_seen())
    nodes = nodes_seen()
    check(f"{phase}: every node is seen", set(names) <= nodes, sorted(set(names) - nodes))
    types = dict(node.get_topic_names_and_types())
    for topic, (kind, publishers, _) in mine.items():
        wrong = types.get(topic) != [kind]
        check(f"{phase}: {topic} is {kind}", not wrong, types.get(topic) if wrong else "")
        real = {p.node_name for p in node.get_publishers_info_by_topic(topic)}
        wanted = set(publishers) & set(names) if "every" not in publishers else set(names)
        check(f"{phase}: {topic} comes from {', '.join(sorted(wanted))}", wanted == real & set(names),
              sorted(real))
        check(f"{phase}: a message on {topic}", bool(seen[topic]))
    published = {t for t in types if node.get_publishers_info_by_topic(t)}
    extra = {t for t in published if t not in topics and "/_action/" not in t} - COMMON
    check(f"{phase}: no topic is missing in the table", not extra, sorted(extra))


def check_parameters(node):
    get = GetParameters.Request(names=["threshold"])
    answer = call(node, GetParameters, "/switch_policy/get_parameters", get)
    check("get a parameter", answer is not None and answer.values[0].double_value > 0)
    for value, good in [(0.85, True), (7.0, False)]:
        p = Parameter(name="threshold", value=ParameterValue(
            type=ParameterType.PARAMETER_DOUBLE, double_value=value))
        answer = call(node, SetParameters, "/switch_policy/set_parameters",
                      SetParameters.Request(parameters=[p]))
        check(f"set a parameter to {value}", answer is not None
              and answer.results[0].successful == good, answer and answer.results[0].reason)


def check_motion(node, seen):
    """A joint trajectory and a gripper goal of our own, while the controller is told to stay out."""
    answer = call(node, Trigger, "/arm_controller/abort", Trigger.Request())
    check("the controller takes an abort", answer is not None and answer.success)
    spin(node, 1.0)
    states = seen["/joint_states"]
    arm = [n for n in states[-1].name if "knuckle" not in n]
    start = dict(zip(states[-1].name, states[-1].position))
    publisher = node.create_publisher(
        JointTrajectory, "/scaled_joint_trajectory_controller/joint_trajectory", 1)
    spin(node, 5.0, lambda: publisher.get_subscription_count() > 0)
    goal = [start[n] + (0.1 if n == "wrist_3_joint" else 0.0) for n in arm]
    message = JointTrajectory(joint_names=arm)
    message.points.append(JointTrajectoryPoint(positions=goal, velocities=[0.0] * 6))
    message.points[0].time_from_start.sec = 1
    publisher.publish(message)

    def arrived():
        now = dict(zip(states[-1].name, states[-1].position))
        return abs(now["wrist_3_joint"] - start["wrist_3_joint"] - 0.1) < 0.01

    check("a joint trajectory is carried out", spin(node, 5.0, arrived))
    client = ActionClient(node, GripperCommand, "/robotiq_gripper_controller/gripper_cmd")
    check("the gripper's action server is there", client.wait_for_server(5.0))
    goal = GripperCommand.Goal()
    # Open: the fingers may be anywhere, also round an object.
    goal.command.position = 0.0
    goal.command.max_effort = 20.0
    sent = client.send_goal_async(goal)
    spin(node, 5.0, sent.done)
    accepted = sent.done() and sent.result().accepted
    check("a gripper goal is accepted", accepted)
    if accepted:
        result = sent.result().get_result_async()
        spin(node, 8.0, result.done)
        good = result.done() and abs(result.result().result.position) < 0.03
        check("a gripper goal is carried out", good)


def check_truth_is_private(node):
    for topic, _ in node.get_topic_names_and_types():
        if topic.startswith(TRUTH):
            readers = {s.node_name for s in node.get_subscriptions_info_by_topic(topic)}
            readers -= {node.get_name(), "tdv_record"}
            check(f"nobody in the graph reads {topic}", not readers, sorted(readers))


def check_our_bag(bag):
    counts = collections.Counter()
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            counts[connection.topic] += 1
        check("rosbags reads every message of our bag", sum(counts.values()) == reader.message_count,
              f"{sum(counts.values())} of {reader.message_count}, {len(counts)} topics")
    check("our bag has the camera and tdv_msgs", counts["/pose_tracker/objects"] > 10
          and counts["/camera/camera/color/image_raw"] > 5)


def rewrite(source, target):
    """The recorded demonstration, written anew by `rosbags`; returns messages and topics."""
    store = get_typestore(Stores.ROS2_JAZZY)
    count = 0
    with AnyReader([source], default_typestore=store) as reader, \
            Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        ids = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore,
                                           offered_qos_profiles=c.ext.offered_qos_profiles)
               for c in reader.connections}
        recorded = {c.topic for c in reader.connections}
        for connection, stamp, raw in reader.messages():
            writer.write(ids[connection.id], stamp, raw)
            count += 1
    return count, recorded


def join(topics):
    """A peer that is there before the graph, as RViz or Foxglove's bridge often are."""
    rclpy.init()
    node = rclpy.create_node("python_peer")
    seen = collections.defaultdict(lambda: collections.deque(maxlen=500))
    subscribe_all(node, topics, seen)
    return node, seen


def main():
    binaries, model = Path(sys.argv[1]).resolve(), sys.argv[2]
    topics = table()
    check("the table has topics", len(topics) > 20, len(topics))
    work = Path(tempfile.mkdtemp(prefix="tdv_peers_"))
    node, seen = join(topics)
    with Graph(binaries, "launch_scripts/closed_loop.launch.yaml", f"model:={model}",
               "auto_resume:=true"):
        recorder = None
        if spin(node, 25.0, lambda: seen["/pose_tracker/objects"]):
            recorder = subprocess.Popen([str(binaries / "tdv"), "record", "-o", str(work / "ours"),
                                         "--duration", "4"], cwd=REPO, stdout=subprocess.DEVNULL)
        check_graph(node, topics, LOOP, seen, "loop")
        check_truth_is_private(node)
        check_parameters(node)
        check_motion(node, seen)
        check("the recorder ends well", recorder is not None and recorder.wait(60) == 0)
    rclpy.shutdown()
    check_our_bag(work / "ours")
    count, recorded = rewrite(REPO / "rosbags/cup_on_coaster", work / "theirs")
    check("rosbags reads and writes the demonstration", count > 300, count)
    node, seen = join(topics)
    with Graph(binaries, "launch_scripts/replay.launch.yaml", f"bag:={work / 'theirs'}",
               f"model:={model}", f"startup_delay:={STARTUP_DELAY}"):
        check_graph(node, topics, REPLAY, seen, "replay", recorded)
        poses = seen["/pose_tracker/objects"]
        check("a bag by rosbags gives poses", spin(
            node, 15.0, lambda: poses and all(o.state > 0 for o in poses[-1].objects)))
    rclpy.shutdown()
    print("\n".join(f"failed: {name}" for name in failures) or "all checks passed")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
