#!/usr/bin/env python3
"""Makes the golden data of the text encoder with PyTorch and transformers.

    make_text_golden.py [MODEL_FOLDER]

Writes, beside itself: tiny/ (a random BERT model with its vocabulary) and tiny.json (its tokens and
vectors for some sentences); with MODEL_FOLDER (all-MiniLM-L6-v2, launch_scripts/fetch_text_model.sh)
also minilm.json. `mean` is the mean of the last hidden state over all tokens, scaled to length 1;
`cls` is the first token's.

Needs: torch, transformers, tokenizers, safetensors.
"""

import json
import pathlib
import sys

import torch
from transformers import BertConfig, BertModel, BertTokenizerFast

HERE = pathlib.Path(__file__).resolve().parent
SENTENCES = [
    "put the mug on the coaster",
    "Put the MUSTARD bottle on the disc!",
    "pour water from the bottle into the cup",
    "insert the peg (2.5 mm) into the hole, then let go",
    "stelle die Tasse auf den Untersetzer — café, naïve Übung",
    "把杯子放在杯垫上",
]
PIECES = (
    "[PAD] [UNK] [CLS] [SEP] [MASK] put the mug on coaster mustard bottle disc pour water from "
    "into cup peg hole then let go tasse auf den die cafe naive ub ##ung ##t ##s st ##elle mm 2 5 "
    ". , ! ( ) — 把 杯 子 放 在 垫 上 un ##ter ##set ##zer in ##ser"
).split()


def golden(folder):
    model = BertModel.from_pretrained(folder, attn_implementation="eager").eval()
    tokenizer = BertTokenizerFast.from_pretrained(folder)
    tokenizer.backend_tokenizer.no_padding()
    sentences = []
    for text in SENTENCES:
        ids = tokenizer(text)["input_ids"]
        with torch.no_grad():
            state = model(input_ids=torch.tensor([ids])).last_hidden_state[0]
        mean = torch.nn.functional.normalize(state.double().mean(0), dim=0)
        sentences.append({
            "text": text,
            "ids": ids,
            "mean": [float(f"{v:.7g}") for v in mean.tolist()],
            "cls": [float(f"{v:.7g}") for v in state[0].tolist()],
        })
    return {"sentences": sentences}


def write(path, value):
    path.write_text(json.dumps(value, ensure_ascii=False) + "\n")


def tiny():
    folder = HERE / "tiny"
    folder.mkdir(exist_ok=True)
    (folder / "vocab.txt").write_text("\n".join(PIECES) + "\n")
    torch.manual_seed(7)
    config = BertConfig(
        vocab_size=len(PIECES), hidden_size=32, num_hidden_layers=2, num_attention_heads=2,
        intermediate_size=48, max_position_embeddings=64, initializer_range=0.3)
    model = BertModel(config, add_pooling_layer=False)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    model.save_pretrained(folder)
    return folder


if __name__ == "__main__":
    write(HERE / "tiny.json", golden(tiny()))
    if len(sys.argv) > 1:
        write(HERE / "minilm.json", golden(sys.argv[1]))
