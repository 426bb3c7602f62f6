#!/usr/bin/env python3
"""Checks the remote perception backend against nodes with the interface of Isaac ROS FoundationPose.

    source DIR/env.sh            (see setup.sh)
    tests/peers/netns.sh tests/peers/isaac_peer.py target/debug models/cup_on_coaster

One estimator for each object stands in for Isaac's: the same relative names, types and encodings, inputs
paired by exactly equal stamps. It answers with the pose that the lab knows, which only a test may. The graph
is launched with `backend:=remote` and nothing else changed. Then the estimators are silent, late, out of
date, in another frame, or wrong: each has to be a stated reason, and never a detection.

    tests/peers/isaac_peer.py --serve mug,coaster       only the estimators, for a graph elsewhere
    tests/peers/isaac_peer.py --trial target/debug models/cup_on_coaster      one trial with the estimators
"""
import collections
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from tdv_msgs.msg import TrackedObject, TrackedObjects
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

REPO = Path(__file__).resolve().parents[2]
OBJECTS = ["coaster", "mug"]
CAMERA = "camera_color_optical_frame"
INPUTS = {"image": Image, "depth_image": Image, "camera_info": CameraInfo, "segmentation": Image}
failures = []


def check(name, good, detail=""):
    print(f"{'ok  ' if good else 'FAIL'} {name} {detail}", flush=True)
    if not good:
        failures.append(name)


def nanoseconds(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def product(a, b):
    """Quaternions x, y, z, w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def rotated(q, v):
    x, y, z, w = product(product(q, (*v, 0.0)), (-q[0], -q[1], -q[2], q[3]))
    return (x, y, z)


def compose(a, b):
    turned = rotated(a[1], b[0])
    return tuple(p + t for p, t in zip(a[0], turned)), product(a[1], b[1])


def inverse(a):
    q = (-a[1][0], -a[1][1], -a[1][2], a[1][3])
    return tuple(-c for c in rotated(q, a[0])), q


def of_message(position, q):
    return (position.x, position.y, position.z), (q.x, q.y, q.z, q.w)


class World(Node):
    """What the lab knows, and what comes out of the graph."""

    def __init__(self):
        super().__init__("isaac_world")
        self.truth, self.links = {}, {}
        # rclpy looks at the signature of a callback, which a deque's own `append` has not.
        self.detections = collections.deque(maxlen=50)
        self.tracked = collections.deque(maxlen=50)
        self.status = collections.deque(maxlen=20)
        self.overlays = collections.deque(maxlen=2)
        best = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(TrackedObjects, "/virtual_lab/ground_truth/objects", self.learn, best)
        self.create_subscription(TFMessage, "/tf_static", self.link, latched)
        self.create_subscription(Detection3DArray, "/perception_bridge/detections",
                                 lambda m: self.detections.append(m), best)
        self.create_subscription(TrackedObjects, "/pose_tracker/objects",
                                 lambda m: self.tracked.append(m), best)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.diagnose, 10)

    def learn(self, message):
        for o in message.objects:
            p = o.pose.pose
            self.truth[o.name] = of_message(p.position, p.orientation)

    def link(self, message):
        for t in message.transforms:
            pose = of_message(t.transform.translation, t.transform.rotation)
            self.links[t.child_frame_id] = (t.header.frame_id, pose)

    def diagnose(self, message):
        self.status.extend(s for s in message.status if s.name == "perception_bridge")

    def look(self):
        best = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Image, "/perception_bridge/overlay",
                                 lambda m: self.overlays.append(m), best)

    def in_camera(self, name):
        """T_camera_object as the lab knows it, or nothing yet."""
        if name not in self.truth or CAMERA not in self.links:
            return None
        frame, pose = CAMERA, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        while frame != "base_link":
            if frame not in self.links:
                return None
            frame, step = self.links[frame]
            pose = compose(step, pose)
        return compose(inverse(pose), self.truth[name])


class Estimator(Node):
    """FoundationPose's names for one object, in a namespace of its own; the images come once for all."""

    def __init__(self, name, world):
        shared = [a for i in INPUTS if i != "segmentation"
                  for a in ("-r", f"pose_estimation/{i}:=/isaac/pose_estimation/{i}")]
        super().__init__("foundationpose", namespace=f"/isaac/{name}",
                         cli_args=["--ros-args", *shared])
        self.object, self.world, self.mode = name, world, "true"
        self.waiting = collections.OrderedDict()
        self.paired, self.problems, self.later, self.last = 0, set(), [], None
        self.publishers_ = {
            source: self.create_publisher(Detection3DArray, f"{source}/output", 10)
            for source in ("pose_estimation", "tracking")}
        for key, kind in INPUTS.items():
            self.create_subscription(kind, f"pose_estimation/{key}",
                                     lambda m, key=key: self.arrived(key, m), 10)
        self.create_timer(0.02, self.send_later)

    def arrived(self, key, message):
        stamp = nanoseconds(message.header.stamp)
        inputs = self.waiting.setdefault(stamp, {})
        inputs[key] = message
        if len(inputs) == len(INPUTS):
            del self.waiting[stamp]
            self.paired += 1
            self.inspect(inputs)
            self.answer(inputs["image"].header)
        while len(self.waiting) > 20:
            self.waiting.popitem(last=False)

    def inspect(self, inputs):
        """What the real node refuses."""
        wanted = {"image": "rgb8", "depth_image": "32FC1", "segmentation": "mono8"}
        size = (inputs["camera_info"].width, inputs["camera_info"].height)
        for key, encoding in wanted.items():
            image = inputs[key]
            if image.encoding != encoding:
                self.problems.add(f"{key} is {image.encoding}")
            if (image.width, image.height) != size:
                self.problems.add(f"{key} has another size")
        if {m.header.frame_id for m in inputs.values()} != {CAMERA}:
            self.problems.add("frames differ")
        if not set(bytes(inputs["segmentation"].data)) <= {0, 255}:
            self.problems.add("a mask that is not 0 and 255")
        if 255 not in bytes(inputs["segmentation"].data):
            self.problems.add("an empty mask")

    def answer(self, header):
        pose = self.world.in_camera(self.object)
        if pose is None or self.mode == "silent":
            return
        out = Detection3DArray(header=header)
        if self.mode == "stale":
            # Of an image long ago, with a pose that was right then.
            out.header.stamp.sec -= 2
        if self.mode == "frame":
            out.header.frame_id = "base_link"
            pose = self.world.truth[self.object]
        if self.mode == "wrong":
            pose = (tuple(p + d for p, d in zip(pose[0], (0.08, 0.0, -0.03))), pose[1])
        result = ObjectHypothesisWithPose()
        result.hypothesis.class_id = self.object
        # The estimator is always sure.
        result.hypothesis.score = 1.0
        p, q = result.pose.pose.position, result.pose.pose.orientation
        p.x, p.y, p.z = pose[0]
        q.x, q.y, q.z, q.w = pose[1]
        if self.mode == "nan":
            p.x = float("nan")
        detection = Detection3D(header=out.header, results=[result])
        out.detections.append(detection)
        source = "tracking" if self.last else "pose_estimation"
        self.last = True
        if self.mode == "late":
            self.later.append((time.monotonic() + 1.2, source, out))
        else:
            self.publishers_[source].publish(out)

    def send_later(self):
        while self.later and self.later[0][0] <= time.monotonic():
            _, source, out = self.later.pop(0)
            self.publishers_[source].publish(out)


class Stage:
    def __init__(self):
        rclpy.init()
        self.world = World()
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.world)
        self.estimators = []

    def add(self, name):
        estimator = Estimator(name, self.world)
        self.estimators.append(estimator)
        self.executor.add_node(estimator)

    def spin(self, seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self.executor.spin_once(timeout_sec=0.02)
        return until()

    def mode(self, mode):
        for e in self.estimators:
            e.mode = mode

    def scores(self):
        if not self.world.detections:
            return {}
        return {d.id: d.results[0].hypothesis.score for d in self.world.detections[-1].detections
                if d.results and d.id != "table"}

    def seen(self):
        scores = self.scores()
        return set(scores) == set(OBJECTS) and all(s > 0.35 for s in scores.values())

    def said(self, words):
        return any(words in s.message for s in self.world.status)

    def error(self, name):
        """Distance (m) of the tracker's pose from the lab's."""
        for o in self.world.tracked[-1].objects if self.world.tracked else []:
            if o.name == name and o.state == TrackedObject.TRACKING:
                p, t = o.pose.pose.position, self.world.truth[name][0]
                return ((p.x - t[0]) ** 2 + (p.y - t[1]) ** 2 + (p.z - t[2]) ** 2) ** 0.5
        return 9.0


def check_faults(stage, patience):
    """Each fault: no detection while it lasts, its reason, and recovery."""
    faults = [("silent", "no answer within"), ("late", "no answer within"),
              ("stale", "no answer within"), ("frame", "base_link"), ("nan", "unusable"),
              ("wrong", "disagrees with the image")]
    for mode, words in faults:
        stage.mode(mode)
        # What was on its way still counts.
        stage.spin(4 * patience)
        stage.world.detections.clear()
        stage.world.status.clear()
        stage.spin(15.0, lambda: len(stage.world.detections) >= 3 and stage.said(words))
        answers = list(stage.world.detections)
        confident = [d.id for a in answers for d in a.detections
                     if d.id != "table" and d.results[0].hypothesis.score > 0.0]
        check(f"{mode}: never a detection", answers and not confident, f"in {len(answers)} frames")
        check(f"{mode}: the reason is said", stage.said(words),
              [s.message for s in list(stage.world.status)[-1:]])
        stage.mode("true")
        check(f"{mode}: it recovers", stage.spin(30.0, stage.seen), stage.scores())
    values = {v.key: v.value for v in stage.world.status[-1].values} if stage.world.status else {}
    for key in ("remote_believed", "remote_unanswered", "remote_stale_answers", "remote_wrong_frame",
                "remote_unusable", "remote_disagreeing"):
        check(f"diagnostics count {key}", int(values.get(key, 0)) > 0, values.get(key))
    print("     answers after", values.get("remote_answer_p50_ms"), "ms (median)", flush=True)


def check_graph(stage, binaries, model, patience):
    for name in OBJECTS:
        stage.add(name)
    launch = [str(binaries / "tdv"), "launch", "launch_scripts/closed_loop.launch.yaml",
              f"model:={model}", "auto_resume:=false", "backend:=remote", f"patience:={patience}"]
    graph = subprocess.Popen(launch, cwd=REPO)
    try:
        check("all objects are seen through the estimators", stage.spin(90.0, stage.seen),
              stage.scores())
        check("every estimator got four inputs of one stamp",
              all(e.paired > 0 for e in stage.estimators), [e.paired for e in stage.estimators])
        tracked = stage.spin(20.0, lambda: all(stage.error(n) < 0.01 for n in OBJECTS))
        check("the tracker has them where the lab has", tracked, {n: stage.error(n) for n in OBJECTS})
        stage.world.look()
        check("an overlay comes when somebody looks",
              stage.spin(20.0, lambda: stage.world.overlays))
        if stage.world.overlays:
            picture = stage.world.overlays[-1]
            check("the overlay is rgb8", picture.encoding == "rgb8", picture.encoding)
        check_faults(stage, patience)
        problems = {p for e in stage.estimators for p in e.problems}
        check("what the estimators get is what Isaac's take", not problems, sorted(problems))
        return stage.world.overlays[-1] if stage.world.overlays else None
    finally:
        graph.send_signal(signal.SIGINT)
        try:
            graph.wait(20)
        except subprocess.TimeoutExpired:
            graph.kill()
            check("the graph ends when asked", False)


def check_trial(stage, binaries, model):
    """The demo's closed loop, nothing changed but the launch argument."""
    for name in OBJECTS:
        stage.add(name)
    command = [str(binaries / "tdv"), "eval", "closed-loop", "--task", "config/tasks/cup_on_coaster.yaml",
               "--model", model, "--trials", "1", "--seed", "1", "--live", "--set", "backend:=remote",
               "--set", "patience:=1.0"]
    trial = subprocess.Popen(command, cwd=REPO)
    stage.spin(120.0, lambda: trial.poll() is not None)
    if trial.poll() is None:
        trial.send_signal(signal.SIGINT)
    check("the object is placed", trial.wait(20) == 0)
    check("every estimator was asked", all(e.paired > 0 for e in stage.estimators),
          [e.paired for e in stage.estimators])


def save(picture, path):
    """A binary PPM of an rgb8 message."""
    head = f"P6 {picture.width} {picture.height} 255\n".encode()
    Path(path).write_bytes(head + bytes(picture.data))


def main():
    mode = sys.argv[1]
    if mode == "--trial":
        # The graph of a trial has its own domain, by its seed.
        os.environ["ROS_DOMAIN_ID"] = "61"
    stage = Stage()
    if mode == "--serve":
        for name in sys.argv[2].split(","):
            stage.add(name)
        stage.spin(1e9)
        return
    if mode == "--trial":
        check_trial(stage, Path(sys.argv[2]).resolve(), sys.argv[3])
    else:
        picture = check_graph(stage, Path(mode).resolve(), sys.argv[2], 1.0)
        if picture and len(sys.argv) > 3:
            save(picture, sys.argv[3])
    rclpy.shutdown()
    print("\n".join(f"failed: {name}" for name in failures) or "all checks passed")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
