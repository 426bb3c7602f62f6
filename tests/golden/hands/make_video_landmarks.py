"""Writes video_landmarks.json: MediaPipe's hand landmarks on frames of a real video.

    pip install mediapipe==0.10.14
    python make_video_landmarks.py human_hand_video.mp4 [FRAMES_DIR]

The video is dex-retargeting's example/vector_retargeting/data/human_hand_video.mp4 (MIT). Each
frame is looked at on its own (static image mode), model complexity 1. Pixels have their centres at
integer coordinates. With FRAMES_DIR the frames used are also written there, as NNNN.png, for the
test that reads them (environment variable TDV_HAND_FRAMES).
"""
import json
import pathlib
import sys

import cv2
import mediapipe as mp

EVERY = 60

video = cv2.VideoCapture(sys.argv[1])
folder = pathlib.Path(sys.argv[2]) if len(sys.argv) > 2 else None
if folder:
    folder.mkdir(parents=True, exist_ok=True)
hands = mp.solutions.hands.Hands(static_image_mode=True, max_num_hands=1, model_complexity=1)
frames = []
number = -1
while True:
    ok, image = video.read()
    number += 1
    if not ok:
        break
    if number % EVERY:
        continue
    result = hands.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    if not result.multi_hand_landmarks:
        continue
    height, width = image.shape[:2]
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
    if folder:
        cv2.imwrite(str(folder / f"{number:04d}.png"), image)
target = pathlib.Path(__file__).parent / "video_landmarks.json"
target.write_text(json.dumps({"width": width, "height": height, "frames": frames},
                             separators=(",", ":")) + "\n")
print(target, len(frames), "frames,", target.stat().st_size, "bytes")
