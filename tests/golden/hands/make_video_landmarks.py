"""Writes MediaPipe's hand landmarks on frames of a real video.

    pip install mediapipe==0.10.14
    python make_video_landmarks.py human_hand_video.mp4 [FRAMES_DIR]
    python make_video_landmarks.py human_hand_video.mp4 FRAMES_DIR --follow --out landmarks.json

The video is dex-retargeting's example/vector_retargeting/data/human_hand_video.mp4 (MIT). The first
form makes video_landmarks.json: every 60th frame, each looked at on its own (static image mode), model
complexity 1. With FRAMES_DIR the frames used are also written there, as NNNN.png, for the test that
reads them (environment variable TDV_HAND_FRAMES). The second form goes through all frames and follows
the hand from one to the next, which `tdv eval hands --frames FRAMES_DIR --landmarks landmarks.json`
is compared with; that is 0.8 GB of frames. Pixels have their centres at integer coordinates.
"""
import argparse
import json
import pathlib

import cv2
import mediapipe as mp

here = pathlib.Path(__file__).parent
parser = argparse.ArgumentParser()
parser.add_argument("video")
parser.add_argument("frames", nargs="?", type=pathlib.Path)
parser.add_argument("--follow", action="store_true")
parser.add_argument("--out", type=pathlib.Path, default=here / "video_landmarks.json")
args = parser.parse_args()

every = 1 if args.follow else 60
video = cv2.VideoCapture(args.video)
folder = args.frames
if folder:
    folder.mkdir(parents=True, exist_ok=True)
hands = mp.solutions.hands.Hands(
    static_image_mode=not args.follow, max_num_hands=1, model_complexity=1)
frames = []
number = -1
while True:
    ok, image = video.read()
    number += 1
    if not ok:
        break
    if number % every:
        continue
    result = hands.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    height, width = image.shape[:2]
    if folder:
        cv2.imwrite(str(folder / f"{number:04d}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not result.multi_hand_landmarks:
        continue
    frames.append({
        "frame": number,
        # MediaPipe names the hand as in a mirrored image.
        "mediapipe_label": result.multi_handedness[0].classification[0].label,
        "score": round(result.multi_handedness[0].classification[0].score, 4),
        "pixels": [[round(p.x * width, 2), round(p.y * height, 2)]
                   for p in result.multi_hand_landmarks[0].landmark],
        "world": [[round(p.x, 5), round(p.y, 5), round(p.z, 5)]
                  for p in result.multi_hand_world_landmarks[0].landmark],
    })
args.out.write_text(json.dumps({"width": width, "height": height, "frames": frames},
                               separators=(",", ":")) + "\n")
print(args.out, len(frames), "of", number, "frames with a hand,", args.out.stat().st_size, "bytes")
