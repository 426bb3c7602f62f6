#!/usr/bin/env python3
"""Turns FoundationPose's released checkpoints into the two weight files that TDV reads.

    launch_scripts/convert_foundationpose.py WEIGHTS_DIR [--out models/foundationpose]

WEIGHTS_DIR is the folder of the release, with 2023-10-28-18-33-37/model_best.pth (refiner) and
2024-01-11-20-02-45/model_best.pth (scorer). The weights are NVIDIA's, under the NVIDIA Source Code
License (research and evaluation only); converting them does not change that. Needs torch and
safetensors (pip install torch safetensors). Only tensors are read from the checkpoints
(weights_only): code inside a checkpoint is not run.

Names are kept, but for three things: a leading "module." goes, "model." too; the convolution and the
batch normalisation of an encoder's unit are called layers.0 and layers.1 whatever their container is
called; counters and position codes, which TDV does not need, are dropped. Every name and shape is
checked before anything is written.
"""

import argparse
import pathlib
import re
import sys

RUNS = {
    "refiner": ("2023-10-28-18-33-37", "foundationpose_refiner.safetensors"),
    "scorer": ("2024-01-11-20-02-45", "foundationpose_scorer.safetensors"),
}
DROPPED = re.compile(r"(num_batches_tracked$)|(^pos_embed\.)")
UNIT = re.compile(r"^(encode[r]?AB?\.\d)\.(?!conv\d|bn\d|layers\.)[A-Za-z_]\w*\.(\d\.)")


def rename(name):
    """A checkpoint's tensor name to TDV's, or None for what is left out."""
    name = re.sub(r"^(module\.|model\.)+", "", name)
    return None if DROPPED.search(name) else UNIT.sub(r"\1.layers.\2", name)


def _norm(name, width, parts=("weight", "bias", "running_mean", "running_var")):
    return {f"{name}.{p}": (width,) for p in parts}


def _conv(name, inputs, outputs, kernel):
    return {f"{name}.weight": (outputs, inputs, kernel, kernel), f"{name}.bias": (outputs,)}


def _unit(name, inputs, outputs, kernel):
    return _conv(f"{name}.layers.0", inputs, outputs, kernel) | _norm(f"{name}.layers.1", outputs)


def _block(name, width):
    table = {}
    for i in (1, 2):
        table |= _conv(f"{name}.conv{i}", width, width, 3) | _norm(f"{name}.bn{i}", width)
    return table


def _linear(name, inputs, outputs):
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def _attention(name, width):
    packed = {f"{name}.in_proj_weight": (3 * width, width), f"{name}.in_proj_bias": (3 * width,)}
    return packed | _linear(f"{name}.out_proj", width, width)


def expected(network, c=64):
    """Names and shapes of a network whose first convolution has c channels."""
    one, two = ("encodeA", "encodeAB") if network == "refiner" else ("encoderA", "encoderAB")
    w = 8 * c
    table = _unit(f"{one}.0", 6, c, 7) | _unit(f"{one}.1", c, 2 * c, 3)
    table |= _block(f"{one}.2", 2 * c) | _block(f"{one}.3", 2 * c)
    table |= _block(f"{two}.0", 4 * c) | _block(f"{two}.1", 4 * c) | _unit(f"{two}.2", 4 * c, w, 3)
    table |= _block(f"{two}.3", w) | _block(f"{two}.4", w)
    if network == "scorer":
        return table | _attention("att", w) | _attention("att_cross", w) | _linear("linear", w, 1)
    for head in ("trans_head", "rot_head"):
        table |= _attention(f"{head}.0.self_attn", w) | _linear(f"{head}.1", w, 3)
        for i in (1, 2):
            table |= _linear(f"{head}.0.linear{i}", w, w)
            table |= _norm(f"{head}.0.norm{i}", w, ("weight", "bias"))
    return table


def convert(state, network, c=64):
    """Renamed tensors of a state dict, and a list of what does not fit."""
    out, want = {}, expected(network, c)
    for name, tensor in state.items():
        new = rename(name)
        if new is not None:
            out[new] = tensor.detach().float().contiguous()
    problems = [f"missing: {n} {want[n]}" for n in sorted(want.keys() - out.keys())]
    problems += [f"unknown: {n} {tuple(out[n].shape)}" for n in sorted(out.keys() - want.keys())]
    problems += [f"shape of {n}: {tuple(out[n].shape)}, expected {want[n]}"
                 for n in sorted(out.keys() & want.keys()) if tuple(out[n].shape) != want[n]]
    return out, problems


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("models/foundationpose"))
    args = parser.parse_args()
    try:
        import torch
        from safetensors.torch import save_file
    except ImportError as error:
        sys.exit(f"convert_foundationpose: {error}; pip install torch safetensors")
    results = {}
    for network, (run, target) in RUNS.items():
        path = args.weights / run / "model_best.pth"
        if not path.is_file():
            sys.exit(f"convert_foundationpose: {path}: no such file; is {args.weights} the release's folder?")
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        state, problems = convert(checkpoint.get("model", checkpoint), network)
        if problems:
            sys.exit(f"convert_foundationpose: {path} is not the {network} that TDV knows:\n  "
                     + "\n  ".join(problems[:20]))
        results[target] = state
    args.out.mkdir(parents=True, exist_ok=True)
    for target, state in results.items():
        part = args.out / (target + ".part")
        licence = "NVIDIA Source Code License: research and evaluation only"
        save_file(state, part, metadata={"licence": licence})
        part.replace(args.out / target)
        print(f"{args.out / target}: {sum(t.numel() for t in state.values())} numbers")


if __name__ == "__main__":
    main()
