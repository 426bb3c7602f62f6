#!/usr/bin/env python3
"""The trajectory network once more in PyTorch, side by side with ours.

    policy_torch.py golden              writes tests/golden/policy/network.safetensors: output and
                                        gradients of every tensor for weights given by a formula
    policy_torch.py compare [EXAMPLE [TURNS]]
                                        runs the Rust example policy_speed (EXAMPLE is its program,
                                        by default it is built and run by cargo), loads the checkpoint
                                        that it writes, compares outputs, and prints the times of a
                                        training step and of a ten-step plan of both

Times are the least process CPU time of several repeats on one thread; the two programs take turns.
Needs: torch, numpy, safetensors.
"""

import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from torch.nn import functional as F

ROOT = pathlib.Path(__file__).resolve().parents[2]
POSE = 9


def names_and_shapes(c, procedures, text):
    """The tensors of a checkpoint in their order; linear weights are [inputs, outputs]."""
    d = c["d_model"]
    out = []

    def linear(name, inputs, outputs):
        out.append((f"{name}.weight", [inputs, outputs]))
        out.append((f"{name}.bias", [outputs]))

    def block(name):
        linear(f"{name}.qkv", d, 3 * d)
        linear(f"{name}.out", d, d)
        linear(f"{name}.up", d, 4 * d)
        linear(f"{name}.down", 4 * d, d)

    linear("history.0", POSE, d)
    linear("history.1", d, d)
    if text:
        linear("text", text, d)
    out.append(("procedures", [procedures, d]))
    out.append(("positions", [c["history"] + 2, d]))
    out.append(("modalities", [3, d]))
    for i in range(c["encoder_layers"]):
        out.append((f"encoder.{i}.norms", [4, d]))
        block(f"encoder.{i}")
    linear("time.0", d, d)
    linear("time.1", d, d)
    linear("pose_in", POSE, d)
    out.append(("horizon_positions", [c["horizon"], d]))
    for i in range(c["decoder_layers"]):
        linear(f"decoder.{i}.modulation", d, 6 * d)
        block(f"decoder.{i}")
    linear("final.modulation", d, 2 * d)
    linear("final.output", d, POSE)
    return out


class Network:
    def __init__(self, config, tensors):
        self.c = config
        self.p = {n: torch.tensor(t, requires_grad=True) for n, t in tensors.items()}

    def linear(self, name, x):
        return x @ self.p[f"{name}.weight"] + self.p[f"{name}.bias"]

    def norm(self, x, shift, scale):
        return F.layer_norm(x, x.shape[-1:], eps=1e-6) * (1 + scale) + shift

    def block(self, name, x, shift1, scale1, shift2, scale2, gate1=1.0, gate2=1.0):
        b, n, d = x.shape
        heads = self.c["heads"]
        qkv = self.linear(f"{name}.qkv", self.norm(x, shift1, scale1))
        q, k, v = qkv.view(b, n, 3, heads, d // heads).permute(2, 0, 3, 1, 4)
        a = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(b, n, d)
        x = x + gate1 * self.linear(f"{name}.out", a)
        u = F.gelu(self.linear(f"{name}.up", self.norm(x, shift2, scale2)), approximate="tanh")
        return x + gate2 * self.linear(f"{name}.down", u)

    def encode(self, history, procedure, text=None, task=None):
        u = F.gelu(self.linear("history.0", history), approximate="tanh")
        tokens = self.linear("history.1", u)
        d = tokens.shape[-1]
        words = torch.zeros(len(history), 1, d)
        if text is not None:
            words = self.linear("text", text)[task].unsqueeze(1)
        m = self.p["modalities"]
        number = self.p["procedures"][procedure].unsqueeze(1)
        x = torch.cat([tokens + m[0], words + m[1], number + m[2]], 1) + self.p["positions"]
        for i in range(self.c["encoder_layers"]):
            x = self.block(f"encoder.{i}", x, *self.p[f"encoder.{i}.norms"])
        return x.mean(1)

    def denoise(self, e, noisy, step):
        d = e.shape[-1]
        half = d // 2
        f = torch.exp(torch.arange(half) * (-math.log(1e4) / (half - 1)))
        angle = step[:, None].float() * f
        t = torch.cat([angle.cos(), angle.sin()], 1)
        t = self.linear("time.1", F.silu(self.linear("time.0", t)))
        condition = F.silu(e + t)
        x = self.linear("pose_in", noisy) + self.p["horizon_positions"]
        for i in range(self.c["decoder_layers"]):
            m = self.linear(f"decoder.{i}.modulation", condition).unsqueeze(1).chunk(6, -1)
            x = self.block(f"decoder.{i}", x, m[0], m[1], m[3], m[4], m[2], m[5])
        shift, scale = self.linear("final.modulation", condition).unsqueeze(1).chunk(2, -1)
        return self.linear("final.output", self.norm(x, shift, scale))


def number(n, salt):
    """n numbers in -0.5..0.5 by a formula that any language repeats to the bit."""
    i = np.arange(n, dtype=np.uint64)
    h = (i * np.uint64(2654435761) + np.uint64(salt) * np.uint64(40503) + np.uint64(12345)) % np.uint64(1 << 32)
    h = (h * np.uint64(1103515245) + np.uint64(12345)) % np.uint64(1 << 32)
    return ((h >> np.uint64(8)).astype(np.float64) / (1 << 24) - 0.5).astype(np.float32)


def golden():
    config = dict(history=5, horizon=7, d_model=32, heads=2, encoder_layers=1, decoder_layers=2)
    shapes = names_and_shapes(config, 2, 12)
    tensors = {
        name: number(math.prod(shape), salt).reshape(shape) * np.float32(0.5)
        for salt, (name, shape) in enumerate(shapes)
    }
    net = Network(config, tensors)
    history = torch.tensor(number(3 * 5 * POSE, 101).reshape(3, 5, POSE))
    noisy = torch.tensor(number(3 * 7 * POSE, 102).reshape(3, 7, POSE) * np.float32(2))
    target = torch.tensor(number(3 * 7 * POSE, 103).reshape(3, 7, POSE))
    text = torch.tensor(number(2 * 12, 104).reshape(2, 12))
    e = net.encode(history, torch.tensor([0, 1, 0]), text, torch.tensor([1, 0, 1]))
    output = net.denoise(e, noisy, torch.tensor([0, 57, 99]))
    weight = torch.full([POSE], 1.0 / (3 * 7 * POSE))
    weight[0] *= 2
    loss = (weight * (output - target) ** 2).sum()
    loss.backward()
    out = {f"gradient/{n}": p.grad.numpy() for n, p in net.p.items()}
    out["output"] = output.detach().numpy()
    out["loss"] = np.array([loss.item()], dtype=np.float32)
    folder = ROOT / "tests/golden/policy"
    save_file(out, folder / "network.safetensors")
    print(f"{len(net.p)} tensors, loss {loss.item():.6f}")


def cpu_ms(function, repeats):
    best = math.inf
    for _ in range(repeats):
        begin = time.process_time()
        function()
        best = min(best, time.process_time() - begin)
    return best * 1e3


def training_step(net, batch):
    c = net.c
    g = torch.Generator().manual_seed(1)
    history = torch.randn(batch, c["history"], POSE, generator=g)
    target = torch.randn(batch, c["horizon"], POSE, generator=g)
    noisy = torch.randn(batch, c["horizon"], POSE, generator=g)
    procedure = torch.randint(0, 2, (batch,), generator=g)
    step = torch.randint(0, c["train_steps"], (batch,), generator=g)
    parameters = list(net.p.values())
    optimiser = torch.optim.AdamW(parameters, lr=1e-4, betas=(0.9, 0.98), weight_decay=1e-4)
    average = [p.detach().clone() for p in parameters]

    def run():
        optimiser.zero_grad(set_to_none=True)
        loss = F.mse_loss(net.denoise(net.encode(history, procedure), noisy, step), target)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(parameters, 1.0)
        optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(average, parameters, 0.001)

    return run


def plan(net, steps=10):
    c = net.c
    k = c["train_steps"]
    f = lambda t: math.cos((t / k + 0.008) / 1.008 * math.pi / 2) ** 2
    bars = np.cumprod([1 - min(1 - f(i + 1) / f(i), 0.999) for i in range(k)])
    times = np.linspace(k - 1, 0, steps).round().astype(int)
    history = torch.randn(1, c["history"], POSE)
    noise = torch.randn(1, c["horizon"], POSE)
    procedure = torch.tensor([0])
    tensors = [torch.tensor([int(t)]) for t in times]

    def run():
        with torch.inference_mode():
            e = net.encode(history, procedure)
            x = noise
            for i, t in enumerate(times):
                x0 = net.denoise(e, x, tensors[i]).clamp(-1.1, 1.1)
                ab = bars[t]
                before = bars[times[i + 1]] if i + 1 < steps else 1.0
                eps = (x - math.sqrt(ab) * x0) / math.sqrt(1 - ab)
                x = math.sqrt(before) * x0 + math.sqrt(1 - before) * eps
            return x

    return run


def compare(example, turns):
    torch.set_num_threads(1)
    build = ["cargo", "run", "--quiet", "-p", "tdv-policy", "--example", "policy_speed", "--"]
    command = [example] if example else build
    good = True
    for preset, batch in (("small", 128), ("base", 64)):
        with tempfile.TemporaryDirectory() as folder:
            ours = {}
            theirs = {"step_ms": math.inf, "plan_ms": math.inf}
            for turn in range(turns):
                run = subprocess.run(
                    [*command, folder, preset, str(batch)], cwd=ROOT, check=True, text=True,
                    stdout=subprocess.PIPE, env=dict(os.environ, RAYON_NUM_THREADS="1"))
                for key, value in json.loads(run.stdout).items():
                    ours[key] = min(ours.get(key, math.inf), value)
                path = pathlib.Path(folder) / "policy.safetensors"
                with safe_open(path, "np") as file:
                    config = json.loads(file.metadata()["tdv_policy"])["config"]
                net = Network(config, load_file(path))
                if turn == 0:
                    io = load_file(pathlib.Path(folder) / "io.safetensors")
                    with torch.inference_mode():
                        e = net.encode(torch.tensor(io["history"]), torch.tensor([0, 1, 1]))
                        out = net.denoise(e, torch.tensor(io["noisy"]), torch.tensor([0, 40, 99]))
                    off = float(np.abs(out.numpy() - io["output"]).max())
                    good &= off < 1e-4
                    print(f"{preset}: largest difference of outputs {off:.1e}")
                run_plan, run_step = plan(net), training_step(Network(config, load_file(path)), batch)
                for _ in range(3):
                    run_plan(), run_step()
                theirs["plan_ms"] = min(theirs["plan_ms"], cpu_ms(run_plan, 15))
                theirs["step_ms"] = min(theirs["step_ms"], cpu_ms(run_step, 8))
        for what, key in (("training step", "step_ms"), ("ten-step plan", "plan_ms")):
            print(
                f"{preset}: {what}: ours {ours[key]:.2f} ms, PyTorch {theirs[key]:.2f} ms "
                f"(ours/PyTorch {ours[key] / theirs[key]:.2f}, PyTorch/ours "
                f"{theirs[key] / ours[key]:.1f})")
    return good


if __name__ == "__main__":
    if sys.argv[1:2] == ["golden"]:
        golden()
    elif sys.argv[1:2] == ["compare"]:
        sys.exit(0 if compare(sys.argv[2] if len(sys.argv) > 2 else None, int(sys.argv[3]) if len(sys.argv) > 3 else 4) else 1)
    else:
        sys.exit(__doc__)
