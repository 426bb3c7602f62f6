#!/usr/bin/env python3
"""Writes GroundingDINO and SAM2 as the ONNX files that TDV reads.

    launch_scripts/export_onnx.py --grounding DIR_OF_grounding-dino-tiny --out models/groundingdino
    launch_scripts/export_onnx.py --sam2 DIR_OF_sam2.1-hiera-tiny --out models/sam2

The folders are those of the Hugging Face hub (config.json, model.safetensors; vocab.txt with
GroundingDINO); both models are Apache-2.0. Needs torch, transformers 5 and onnx. Reads safetensors
only, so that no code of the model folder runs.

groundingdino.onnx: pixel_values [1,3,H,W]; input_ids, attention_mask, position_ids, token_type_ids
[1,N]; text_token_mask [1,N,N] -> logits [1,Q,256], pred_boxes [1,Q,4]. H x W is fixed here
(--height, --width), N is free.
sam2_encoder.onnx: pixel_values [1,3,S,S] -> high_res_0, high_res_1, embedding.
sam2_decoder.onnx: these and boxes [1,N,4] -> masks [1,N,3,S/4,S/4], iou [1,N,3], object [1,N,1].
"""

import argparse
import pathlib
import shutil
import sys

import torch
from torch import nn

OPSET = 17


def _export(module, inputs, path, names, outputs, dynamic):
    # In evaluation mode itself, or the exporter would leave the model inside in training mode.
    torch.onnx.export(module.eval(), inputs, str(path), input_names=names, output_names=outputs,
                      dynamic_axes=dynamic, opset_version=OPSET, dynamo=False)
    _single_precision(path)


def _single_precision(path):
    """Sampling points come out of the tracer in double precision, which torch never used and
    onnxruntime has no GridSample for."""
    import onnx
    from onnx import TensorProto, numpy_helper
    model = onnx.load(str(path))

    def single(tensor):
        if tensor.data_type == TensorProto.DOUBLE:
            tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype("float32"), tensor.name))

    for tensor in model.graph.initializer:
        single(tensor)
    for node in model.graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.TENSOR:
                single(attribute.t)
            if node.op_type == "Cast" and attribute.name == "to" and attribute.i == TensorProto.DOUBLE:
                attribute.i = TensorProto.FLOAT
    del model.graph.value_info[:]
    onnx.save(model, str(path))


class Grounding(nn.Module):
    """The detector with the text's blocks as inputs; what makes them has no ONNX form."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, pixel_values, input_ids, attention_mask, position_ids, token_type_ids,
                text_token_mask):
        from transformers.models.grounding_dino import modeling_grounding_dino as code
        name = "generate_masks_with_special_tokens_and_transfer_map"
        original = getattr(code, name)
        setattr(code, name, lambda *_, **__: (text_token_mask, position_ids))
        try:
            mask = torch.ones_like(pixel_values[:, 0], dtype=torch.long)
            out = self.model(pixel_values=pixel_values, input_ids=input_ids,
                             token_type_ids=token_type_ids, attention_mask=attention_mask,
                             pixel_mask=mask)
        finally:
            setattr(code, name, original)
        return out.logits, out.pred_boxes


class Encoder(nn.Module):
    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, pixel_values):
        return tuple(self.model.get_image_embeddings(pixel_values))


class Decoder(nn.Module):
    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, high_res_0, high_res_1, embedding, boxes):
        out = self.model(image_embeddings=[high_res_0, high_res_1, embedding], input_boxes=boxes,
                         multimask_output=True)
        return out.pred_masks, out.iou_scores, out.object_score_logits


def export_grounding(model, out, height, width):
    """`model`: a GroundingDinoForObjectDetection."""
    model.eval()
    # Traced sizes must not decide how the text is used: trace with the text of two phrases.
    n = 9
    tokens = torch.full((1, n), 2)
    inputs = (torch.rand(1, 3, height, width), tokens, torch.ones_like(tokens),
              torch.zeros_like(tokens), torch.zeros_like(tokens),
              torch.eye(n, dtype=torch.bool)[None])
    names = ["pixel_values", "input_ids", "attention_mask", "position_ids", "token_type_ids",
             "text_token_mask"]
    dynamic = {name: {1: "tokens"} for name in names[1:5]} | {"text_token_mask": {1: "tokens", 2: "tokens"}}
    with torch.no_grad():
        _export(Grounding(model), inputs, out / "groundingdino.onnx", names,
                ["logits", "pred_boxes"], dynamic)


def export_sam2(model, out):
    """`model`: a Sam2Model."""
    model.eval()
    side = model.config.vision_config.backbone_config.image_size
    side = side if isinstance(side, int) else side[0]
    pixels = torch.rand(1, 3, side, side)
    features = ["high_res_0", "high_res_1", "embedding"]
    with torch.no_grad():
        _export(Encoder(model), (pixels,), out / "sam2_encoder.onnx", ["pixel_values"], features, {})
        maps = model.get_image_embeddings(pixels)
        boxes = torch.tensor([[[0.1, 0.2, 0.5, 0.6], [0.3, 0.3, 0.9, 0.8]]]) * side
        dynamic = {name: {1: "boxes"} for name in ("boxes", "masks", "iou", "object")}
        _export(Decoder(model), (*maps, boxes), out / "sam2_decoder.onnx", [*features, "boxes"],
                ["masks", "iou", "object"], dynamic)


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grounding", type=pathlib.Path)
    parser.add_argument("--sam2", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--height", type=int, default=800)
    parser.add_argument("--width", type=int, default=1067)
    args = parser.parse_args()
    if not (args.grounding or args.sam2):
        parser.error("one of --grounding and --sam2")
    for folder in filter(None, (args.grounding, args.sam2)):
        if not (folder / "config.json").is_file():
            sys.exit(f"export_onnx: {folder}/config.json: no such file; is it a model's folder?")
    import transformers
    args.out.mkdir(parents=True, exist_ok=True)
    # Attention written out; the fused forms differ between torch and onnxruntime.
    options = {"local_files_only": True, "use_safetensors": True, "attn_implementation": "eager"}
    if args.grounding:
        kind = transformers.GroundingDinoForObjectDetection
        export_grounding(kind.from_pretrained(args.grounding, **options), args.out, args.height, args.width)
        shutil.copy(args.grounding / "vocab.txt", args.out / "vocab.txt")
    if args.sam2:
        export_sam2(transformers.Sam2Model.from_pretrained(args.sam2, **options), args.out)


if __name__ == "__main__":
    main()
