#!/usr/bin/env python3
"""Checks our closed-form inverse kinematics against the PyPI package ur_analytic_ik, pose by pose.

    python3 -m venv DIR && DIR/bin/pip install ur_analytic_ik==0.1.0.post3 numpy
    cargo build -p tdv-robot --example ik_peer
    DIR/bin/python tests/peers/ik_peer.py target/debug/examples/ik_peer [COUNT]

Every solution of either side must be a solution of the other within 1e-9 rad (modulo whole turns).
A pose where they differ is excused only near a singularity, where an angle is worth fewer digits
than that: the allowance is 1e-15 / s for s the smallest of |sin q5|, |sin q3| and the relative
distance of the wrist centre from the cylinder about the base axis. Without the package the check is
skipped with exit code 77; a disagreement exits with 1.
"""
import subprocess
import sys

try:
    import numpy as np
    from ur_analytic_ik import ur5, ur5e
except ImportError as e:
    print(f"skipped: {e}")
    sys.exit(77)

TOLERANCE = 1e-9
WRIST = {"ur5": (0.10915, 0.0823), "ur5e": (0.1333, 0.0996)}


def farthest(a, b):
    """Greatest distance of a row of `a` from its nearest row of `b`."""
    d = (a[:, None, :] - b[None, :, :] + np.pi) % (2 * np.pi) - np.pi
    return np.abs(d).max(axis=2).min(axis=1).max()


def singularity(name, pose, q):
    """How near the pose is to a singularity, 0 at one."""
    d4, d6 = WRIST[name]
    centre = pose[:2, 3] - d6 * pose[:2, 2]
    along = np.sqrt(max(centre @ centre - d4 * d4, 0.0))
    return min(np.abs(np.sin(q[:, 4])).min(), np.abs(np.sin(q[:, 2])).min(), along)


def records(data):
    i = 0
    while i < len(data):
        pose, n = data[i:i + 16].reshape(4, 4), int(data[i + 16])
        yield pose, data[i + 17:i + 17 + 6 * n].reshape(n, 6)
        i += 17 + 6 * n


def run(program, name, arm, count):
    data = np.frombuffer(subprocess.run([program, name, str(count), "7"], check=True,
                                        stdout=subprocess.PIPE).stdout)
    worst, poses, excused, bad = 0.0, 0, 0, 0
    for pose, ours in records(data):
        poses += 1
        theirs = np.array([np.ravel(s) for s in arm.inverse_kinematics(pose)])
        if len(ours) == 0 or len(theirs) == 0:
            gap = np.inf if len(ours) != len(theirs) else 0.0
        else:
            gap = max(farthest(ours, theirs), farthest(theirs, ours))
            if len(ours) != len(theirs):
                gap = np.inf
        if gap <= TOLERANCE:
            worst = max(worst, gap)
            continue
        near = singularity(name, pose, ours) if len(ours) else 0.0
        if gap <= 1e-15 / max(near, 1e-300):
            excused += 1
            kind = "excused"
        else:
            bad += 1
            kind = "FAIL"
        print(f"{kind} {name} pose {poses}: {len(ours)} against {len(theirs)} solutions, "
              f"{gap:.1e} rad apart, singularity {near:.1e}")
    print(f"{'FAIL' if bad else 'ok  '} {name}: {poses} poses, {poses - excused - bad} agree "
          f"(worst {worst:.1e} rad), {excused} near a singularity, {bad} differ")
    return bad == 0 and poses == count


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 100_000
    good = [run(sys.argv[1], name, arm, count) for name, arm in (("ur5", ur5), ("ur5e", ur5e))]
    sys.exit(0 if all(good) else 1)


main()
