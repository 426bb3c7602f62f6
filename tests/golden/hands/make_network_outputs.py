"""Writes network_outputs.json: what the reference interpreter gives for a fixed input.

    pip install ai-edge-litert numpy
    python make_network_outputs.py MODELS_DIR

MODELS_DIR is the folder that launch_scripts/fetch_hand_models.sh fills. Input value number i
(row-major, channels last) is ((7919 i) mod 1009) / 1008. Of outputs with more than 200 values
every n-th is kept, so that the file stays small.
"""
import json
import pathlib
import sys

import numpy as np
from ai_edge_litert.interpreter import Interpreter

models = pathlib.Path(sys.argv[1])
golden = {}
for name in ("palm_detection_full", "hand_landmark_full"):
    interpreter = Interpreter(str(models / f"{name}.tflite"), num_threads=1)
    interpreter.allocate_tensors()
    (details,) = interpreter.get_input_details()
    count = int(np.prod(details["shape"]))
    values = ((np.arange(count, dtype=np.int64) * 7919) % 1009 / 1008.0).astype(np.float32)
    interpreter.set_tensor(details["index"], values.reshape(details["shape"]))
    interpreter.invoke()
    outputs = {}
    for output in interpreter.get_output_details():
        flat = interpreter.get_tensor(output["index"]).astype(np.float64).ravel()
        step = 1 if flat.size <= 200 else flat.size // 150 | 1
        outputs[output["name"]] = {
            "length": int(flat.size),
            "step": step,
            "values": [round(float(v), 6) for v in flat[::step]],
        }
    golden[name] = outputs
target = pathlib.Path(__file__).parent / "network_outputs.json"
target.write_text(json.dumps(golden, indent=None, separators=(",", ":")) + "\n")
print(target, target.stat().st_size, "bytes")
