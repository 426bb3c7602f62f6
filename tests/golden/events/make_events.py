#!/usr/bin/env python3
"""Writes golden.tfevents with TensorBoard's own protocol buffers and record writer, reads it with its
own reader, and prints what that sees. Needs: tensorboard."""

import pathlib

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

PATH = pathlib.Path(__file__).resolve().parent / "golden.tfevents"
START = 1.75e9


def events():
    yield Event(wall_time=START, file_version="brain.Event:2")
    yield Event(wall_time=START, step=300, session_log=SessionLog(status=SessionLog.START))
    for step in (300, 301, 70_000):
        values = [
            Summary.Value(tag="train/loss", simple_value=1.0 / step),
            Summary.Value(tag="rollout/success", simple_value=0.975),
        ]
        yield Event(wall_time=START + step * 0.125, step=step, summary=Summary(value=values))


if __name__ == "__main__":
    with PATH.open("wb") as file:
        writer = RecordWriter(file)
        for event in events():
            writer.write(event.SerializeToString(deterministic=True))
        writer.flush()
    read = EventAccumulator(str(PATH))
    read.Reload()
    for tag in read.Tags()["scalars"]:
        print(tag, [(e.step, e.value) for e in read.Scalars(tag)])
