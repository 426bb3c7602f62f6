"""Reference data for the ONNX backends (crates/foundation/src/text_image and src/onnx).

    python make_onnx_networks.py --phrases                writes phrases.json beside this file (committed)
    python make_onnx_networks.py OUT_DIR                  tiny random networks, with what transformers says

The networks go through launch_scripts/export_onnx.py, as a user's would. They are too large to be
committed; set TDV_ONNX_GOLDEN=OUT_DIR and ORT_DYLIB_PATH for `cargo test -p tdv-foundation --features
onnx` to compare. Needs torch, transformers 5 and onnx.
"""

import json
import pathlib
import sys

import torch
from transformers import (BertConfig, BertTokenizerFast, GroundingDinoConfig,
                          GroundingDinoForObjectDetection, Sam2Config, Sam2HieraDetConfig,
                          Sam2MaskDecoderConfig, Sam2Model, Sam2PromptEncoderConfig, Sam2VisionConfig,
                          SwinConfig)
from transformers.models.grounding_dino.modeling_grounding_dino import (
    generate_masks_with_special_tokens_and_transfer_map as blocks)

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parents[2] / "launch_scripts"))
import export_onnx  # noqa: E402

VOCABULARY = ("[PAD] [UNK] [CLS] [SEP] [MASK] . , ? ! - ' ( ) a the red blue mug cup tea pot ##pot coaster "
              "bottle mustard can ##s ##ed ##ing un ##tidy tidy cafe uber nai ##ve 0 1 ##0 ##5 5 box of "
              "\u4e2d \u00df stra ##\u00dfe \u2014").split()
TEXTS = ["red mug", "Red  MUG.", "the teapot", "tea pots", "untidy", "caf\u00e9", "\u00dcber cafe\u0301",
         "na\u00efve", "mug, cup; bottle", "105", "51", "mustard-bottle's box", "\u4e2dmug\u4e2d", "xyz mug",
         "stra\u00dfe", "a\u2014b", "box\tof\ncans\u0000", "", "mug" * 40, "(red) mug?"]
PROMPTS = [["red mug"], ["red mug", "coaster"], ["the blue teapot", "mustard bottle.", "box of cans"]]


def tokenizer(folder):
    path = folder / "vocab.txt"
    path.write_text("\n".join(VOCABULARY) + "\n")
    return BertTokenizerFast(vocab={v: i for i, v in enumerate(VOCABULARY)}, do_lower_case=True)


def phrases(folder):
    t = tokenizer(folder)
    prompts = []
    for p in PROMPTS:
        text = " ".join(f"{phrase.rstrip('.')} ." for phrase in p)
        ids = torch.tensor([t(text)["input_ids"]])
        special = torch.tensor([VOCABULARY.index(s) for s in ("[CLS]", "[SEP]", ".", "?")])
        sees, positions = blocks(ids, special)
        prompts.append({"phrases": p, "ids": ids[0].tolist(), "positions": positions[0].tolist(),
                        "sees": sees[0].int().flatten().tolist()})
    texts = [(text, t(text)["input_ids"]) for text in TEXTS]
    return {"vocabulary": VOCABULARY, "texts": texts, "prompts": prompts}


def image(side_v, side_u):
    v, u = torch.meshgrid(torch.arange(side_v, dtype=torch.float64), torch.arange(side_u, dtype=torch.float64),
                          indexing="ij")
    return torch.stack([torch.sin(0.11 * (c + 1) * u + 0.07 * v + c) + 0.3 * torch.cos(0.05 * u * (v + c) / 9)
                        for c in range(3)])[None].float()


def shake(model, seed):
    """Random weights of a size that lets signals through."""
    g = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for _, p in model.named_parameters():
            fan = p[0].numel() if p.dim() > 1 else 1
            noise = torch.randn(p.shape, generator=g)
            p.copy_(noise / fan**0.5 if p.dim() > 1 else p + 0.2 * noise)
    return model.eval()


def grounding(out):
    swin = SwinConfig(image_size=256, embed_dim=16, depths=[1, 1, 1, 1], num_heads=[1, 2, 4, 8], window_size=4,
                      out_indices=[2, 3, 4])
    bert = BertConfig(vocab_size=len(VOCABULARY), hidden_size=32, num_hidden_layers=2, num_attention_heads=2,
                      intermediate_size=64)
    config = GroundingDinoConfig(
        backbone_config=swin, text_config=bert, d_model=32, encoder_layers=2, decoder_layers=2,
        encoder_attention_heads=2, decoder_attention_heads=2, encoder_ffn_dim=64, decoder_ffn_dim=64,
        num_queries=20, attn_implementation="eager")
    # The blocks part at BERT's numbers, which the small vocabulary does not have.
    model = shake(GroundingDinoForObjectDetection(config), 1)
    export_onnx.export_grounding(model, out, 192, 256)
    prompt = phrases(out)["prompts"][2]
    ids = torch.tensor([prompt["ids"]])
    n = ids.shape[1]
    with torch.no_grad():
        logits, boxes = export_onnx.Grounding(model)(
            image(192, 256), ids, torch.ones_like(ids), torch.tensor([prompt["positions"]]),
            torch.zeros_like(ids), torch.tensor(prompt["sees"]).bool().view(1, n, n))
    return {"phrases": prompt["phrases"], "logits": logits[0, :, :n].flatten().tolist(),
            "boxes": boxes[0].flatten().tolist()}


def sam2(out):
    backbone = Sam2HieraDetConfig(
        hidden_size=12, image_size=[128, 128], blocks_per_stage=[1, 2, 7, 2], embed_dim_per_stage=[12, 24, 48, 96],
        num_attention_heads_per_stage=[1, 2, 4, 8], window_size_per_stage=[8, 4, 14, 7],
        global_attention_blocks=[5, 7, 9], window_positional_embedding_background_size=[7, 7])
    vision = Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[96, 48, 24, 12], fpn_hidden_size=32,
        backbone_feature_sizes=[[32, 32], [16, 16], [8, 8]])
    prompt = Sam2PromptEncoderConfig(hidden_size=32, image_size=128, mask_input_channels=4)
    decoder = Sam2MaskDecoderConfig(hidden_size=32, num_hidden_layers=2, num_attention_heads=2, mlp_dim=64,
                                    iou_head_hidden_dim=32)
    config = Sam2Config(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder,
                        attn_implementation="eager")
    model = shake(Sam2Model(config), 2)
    export_onnx.export_sam2(model, out)
    boxes = [[12.0, 20.0, 60.0, 90.0], [30.0, 5.0, 120.0, 70.0], [64.0, 64.0, 100.0, 127.0]]
    with torch.no_grad():
        result = model(pixel_values=image(128, 128), input_boxes=torch.tensor([boxes]), multimask_output=True)
    return {"boxes": boxes, "masks": result.pred_masks[0, :, :, ::4, ::4].flatten().tolist(),
            "iou": result.iou_scores[0].flatten().tolist(),
            "object": result.object_score_logits[0].flatten().tolist()}


def main():
    if sys.argv[1:] == ["--phrases"]:
        import tempfile
        with tempfile.TemporaryDirectory() as folder:
            data = phrases(pathlib.Path(folder))
        (HERE / "phrases.json").write_text(json.dumps(data) + "\n")
        return
    out = pathlib.Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    (out / "grounding.json").write_text(json.dumps(grounding(out)))
    (out / "sam2.json").write_text(json.dumps(sam2(out)))


if __name__ == "__main__":
    main()
