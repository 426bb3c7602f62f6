"""The converter on made-up checkpoints: python test_converter.py (needs torch and safetensors).

Makes checkpoints of the release's size with other container names, converts them by the command line,
and compares every tensor.
"""

import pathlib
import subprocess
import sys
import tempfile

import torch
from safetensors.torch import load_file

HERE = pathlib.Path(__file__).parent
ROOT = HERE.parents[2]
sys.path[:0] = [str(HERE), str(ROOT / "launch_scripts")]
import convert_foundationpose as converter  # noqa: E402
import make_pose_networks as networks  # noqa: E402


def run(folder, out):
    script = ROOT / "launch_scripts" / "convert_foundationpose.py"
    return subprocess.run([sys.executable, script, folder, "--out", out], capture_output=True, text=True)


def main():
    assert converter.rename("module.encodeA.0.net.0.weight") == "encodeA.0.layers.0.weight"
    assert converter.rename("encoderAB.2.layers.1.running_var") == "encoderAB.2.layers.1.running_var"
    assert converter.rename("encodeA.2.conv1.weight") == "encodeA.2.conv1.weight"
    assert converter.rename("encodeA.0.layers.1.num_batches_tracked") is None
    assert converter.rename("pos_embed.pe") is None
    made = {"refiner": networks.Refiner(64), "scorer": networks.Scorer(64)}
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for network, (release, _) in converter.RUNS.items():
            state = made[network].state_dict()
            state["pos_embed.pe"] = torch.zeros(1, 400, 512)
            if network == "scorer":  # both forms occur
                state = {f"module.{k.replace('.layers.', '.net.')}": v for k, v in state.items()}
            (folder / release).mkdir()
            torch.save({"model": state, "epoch": 1} if network == "refiner" else state,
                       folder / release / "model_best.pth")
        done = run(folder, folder / "out")
        assert done.returncode == 0, done.stderr
        for network, (_, target) in converter.RUNS.items():
            got, want = load_file(folder / "out" / target), made[network].state_dict()
            want = {k: v for k, v in want.items() if not k.endswith("num_batches_tracked")}
            assert got.keys() == want.keys(), got.keys() ^ want.keys()
            assert all(torch.equal(got[k], want[k]) for k in want)
        # A network of another shape is refused by name, and nothing is written.
        release, _ = converter.RUNS["scorer"]
        torch.save(networks.Scorer(32).state_dict(), folder / release / "model_best.pth")
        refused = run(folder, folder / "none")
        assert refused.returncode != 0 and "encoderA.0.layers.0.weight" in refused.stderr, refused.stderr
        assert not (folder / "none").exists()
    print("converter: ok")


if __name__ == "__main__":
    main()
