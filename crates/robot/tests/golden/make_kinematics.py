#!/usr/bin/env python3
"""Makes kinematics.json from the PyPI package ur_analytic_ik (pip install ur_analytic_ik numpy).

Each case: joint angles, the matrix base->tool0 (UR controller frame, row-major 4x4), and all
solutions of the package's inverse kinematics. Usage: make_kinematics.py > kinematics.json
"""
import json
import sys

import numpy as np
from ur_analytic_ik import ur5, ur5e

rng = np.random.default_rng(20)
out = {"source": "ur_analytic_ik 0.1.0.post3", "ur5": [], "ur5e": []}
for name, arm in (("ur5", ur5), ("ur5e", ur5e)):
    for i in range(40):
        q = np.zeros(6) if i == 0 else rng.uniform(-np.pi, np.pi, 6)
        t = arm.forward_kinematics(*q)
        solutions = [s.tolist() for s in arm.inverse_kinematics(t)] if i else []
        out[name].append({"q": q.tolist(), "base_tool0": t.reshape(-1).tolist(), "ik": solutions})
# One line a case keeps the file readable in a diff.
sys.stdout.write('{"source": %s' % json.dumps(out["source"]))
for name in ("ur5", "ur5e"):
    sys.stdout.write(',\n"%s": [\n' % name)
    sys.stdout.write(",\n".join(json.dumps(c) for c in out[name]))
    sys.stdout.write("\n]")
sys.stdout.write("}\n")
