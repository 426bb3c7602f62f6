#!/usr/bin/env python3
"""What the scheduling of this machine leaves of a rate, without any robot.

    tests/peers/pace.py PERIOD SECONDS

Two things at once. A control loop of that period asks another process over TCP on loopback once a tick
and waits for its answer, as a robot's client does; a late tick is not made up for. And a third process
sends the number of the tick that it is, as a robot sends its state, to one that keeps the newest and
looks five times a period. Prints one line of JSON: the mean length of a tick of the loop, and the median
step between the numbers that are seen (s). Beside a peer that is being timed it tells what the load of
the machine explains.
"""
import json
import os
import socket
import struct
import sys
import threading
import time


def answer(connection, _):
    while data := connection.recv(64):
        connection.sendall(data)


def send(connection, period):
    begin = time.monotonic()
    while True:
        tick = int((time.monotonic() - begin) / period)
        try:
            connection.sendall(struct.pack("<q", tick))
        except OSError:
            return
        time.sleep(max(0.0, begin + (tick + 1) * period - time.monotonic()))


def start(serve, period):
    """A connection to a process that serves it."""
    listener = socket.create_server(("127.0.0.1", 0))
    if os.fork() == 0:
        connection, _ = listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        serve(connection, period)
        os._exit(0)
    line = socket.create_connection(listener.getsockname())
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listener.close()
    return line


def loop(line, period, seconds):
    count, begin = 0, time.monotonic()
    while (now := time.monotonic()) < begin + seconds:
        line.sendall(b"x")
        line.recv(64)
        time.sleep(max(0.0, now + period - time.monotonic()))
        count += 1
    line.close()
    return (time.monotonic() - begin) / count


def look(line, period, seconds):
    newest = [0]

    def keep():
        rest = b""
        while data := line.recv(4096):
            rest += data
            whole = len(rest) // 8
            if whole:
                newest[0] = struct.unpack_from("<q", rest, 8 * (whole - 1))[0]
                rest = rest[8 * whole:]

    threading.Thread(target=keep, daemon=True).start()
    seen, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        if not seen or newest[0] != seen[-1]:
            seen.append(newest[0])
        time.sleep(period / 5)
    steps = sorted(b - a for a, b in zip(seen, seen[1:]))
    line.shutdown(socket.SHUT_RDWR)
    return period * steps[len(steps) // 2] if steps else seconds


def main(period, seconds):
    asked, told = start(answer, period), start(send, period)
    result = {}
    looking = os.fork()
    if looking == 0:
        asked.close()
        print(json.dumps({"step": look(told, period, seconds)}), flush=True)
        os._exit(0)
    told.close()
    result["mean"] = loop(asked, period, seconds)
    os.waitpid(looking, 0)
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]))
