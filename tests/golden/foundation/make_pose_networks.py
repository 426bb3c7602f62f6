"""Reference outputs for the two pose networks (crates/foundation/src/pose/networks.rs).

    python make_pose_networks.py OUT_DIR [--width 2] [--side 32] [--poses 3] [--seed 7]

Builds both networks from stock torch.nn modules with random weights (batch statistics too), runs them
on inputs that both sides compute from a formula, and writes refiner.safetensors, scorer.safetensors and
pose_networks.json. Needs torch, numpy and safetensors. The committed files come from the defaults; width 64
and side 160 are the size of the released networks.
"""

import argparse
import json
import math
import pathlib

import numpy as np
import torch
from safetensors.torch import save_file
from torch import nn

HEADS = 4


class Unit(nn.Module):
    """Convolution, batch normalisation, ReLU, under the names of the released checkpoint."""

    def __init__(self, inputs, outputs, kernel, stride):
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2), nn.BatchNorm2d(outputs), nn.ReLU())

    def forward(self, x):
        return self.layers(x)


class Block(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, 1, 1)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, 1, 1)
        self.bn2 = nn.BatchNorm2d(width)

    def forward(self, x):
        y = self.bn1(self.conv1(x)).relu()
        return (self.bn2(self.conv2(y)) + x).relu()


def single(c):
    return nn.Sequential(Unit(6, c, 7, 2), Unit(c, 2 * c, 3, 2), Block(2 * c), Block(2 * c))


def pair(c):
    return nn.Sequential(Block(4 * c), Block(4 * c), Unit(4 * c, 8 * c, 3, 2), Block(8 * c), Block(8 * c))


def tokens(one, two, a, b):
    n = len(a)
    x = one(torch.cat([a, b]))
    x = two(torch.cat([x[:n], x[n:]], 1)).flatten(2).transpose(1, 2)
    position = torch.arange(x.shape[1], dtype=torch.float64)[:, None]
    rate = torch.exp(torch.arange(0, x.shape[2], 2, dtype=torch.float64) * (-math.log(1e4) / x.shape[2]))
    code = torch.zeros(x.shape[1:], dtype=torch.float64)
    code[:, 0::2] = torch.sin(position * rate)
    code[:, 1::2] = torch.cos(position * rate)
    return x + code.float()


class Refiner(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.encodeA, self.encodeAB = single(c), pair(c)

        def head():
            layer = nn.TransformerEncoderLayer(8 * c, HEADS, 8 * c, batch_first=True)
            return nn.Sequential(layer, nn.Linear(8 * c, 3))

        self.trans_head, self.rot_head = head(), head()

    def forward(self, a, b):
        x = tokens(self.encodeA, self.encodeAB, a, b)
        return self.trans_head(x).mean(1), self.rot_head(x).mean(1)


class Scorer(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.encoderA, self.encoderAB = single(c), pair(c)
        self.att = nn.MultiheadAttention(8 * c, HEADS, batch_first=True)
        self.att_cross = nn.MultiheadAttention(8 * c, HEADS, batch_first=True)
        self.linear = nn.Linear(8 * c, 1)

    def forward(self, a, b):
        x = tokens(self.encoderA, self.encoderAB, a, b)
        x = self.att(x, x, x, need_weights=False)[0].mean(1)[None]
        return self.linear(self.att_cross(x, x, x, need_weights=False)[0])[0, :, 0]


def image(poses, side, phase):
    """A round thing with waves on it, another one for each pose; the same formula stands in the test."""
    n, c, v, u = np.meshgrid(*(np.arange(k, dtype=np.float64) for k in (poses, 6, side, side)), indexing="ij")
    x, y = (2 * u + 1) / side - 1, (2 * v + 1) / side - 1
    inside = (x - 0.2 * n + 0.1) ** 2 + y**2 < 0.5 + 0.1 * phase
    wave = np.sin((2 + c) * x + (1 + n) * y + phase) + 0.5 * np.cos(3 * c + n - 4 * x * y)
    wave = np.where(c < 3, np.abs(wave) / 1.5, wave)
    return torch.from_numpy(np.where(inside, wave, 0).astype(np.float32))


def randomise(net, generator):
    with torch.no_grad():
        for name, t in net.state_dict().items():
            if name.endswith("running_var"):
                t.copy_(torch.rand(t.shape, generator=generator) + 0.5)
            elif t.dtype == torch.float32:
                fan = t[0].numel() if t.dim() > 1 else 1
                spread = 1.5 / math.sqrt(fan) if t.dim() > 1 else 0.3
                t.copy_(torch.randn(t.shape, generator=generator) * spread)
                if t.dim() == 1 and name.endswith("weight"):
                    t.add_(1.0)


def main():
    args = argparse.ArgumentParser(description=__doc__)
    args.add_argument("out", type=pathlib.Path)
    args.add_argument("--width", type=int, default=2)
    args.add_argument("--side", type=int, default=32)
    args.add_argument("--poses", type=int, default=3)
    args.add_argument("--seed", type=int, default=7)
    args = args.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.backends.mha.set_fastpath_enabled(False)
    generator = torch.Generator().manual_seed(args.seed)
    a, b = image(args.poses, args.side, 0.0), image(args.poses, args.side, 1.0)
    expected = {"poses": args.poses, "side": args.side, "width": args.width}
    for name, net in (("refiner", Refiner(args.width)), ("scorer", Scorer(args.width))):
        randomise(net, generator)
        net.eval()
        with torch.no_grad():
            out = net(a, b)
        if name == "refiner":
            expected["translation"], expected["rotation"] = (t.flatten().tolist() for t in out)
        else:
            expected["score"] = out.tolist()
        expected[f"{name}_parameters"] = sum(p.numel() for p in net.parameters())
        state = {k: v for k, v in net.state_dict().items() if not k.endswith("num_batches_tracked")}
        save_file(state, args.out / f"{name}.safetensors")
    (args.out / "pose_networks.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
