"""Reads a flight's outputs with other programs: JSON lines with Python, NMEA sentences with pynmea2, both for the same frames.

    check_outputs.py PROGRAM WORK

WORK is a folder for the configuration of a flight of three seconds on the simulated camera.
"""

import json
import socket
import subprocess
import sys
from pathlib import Path

import pynmea2

PROGRAM, WORK = sys.argv[1:]
JSONL, NMEA = 47125, 47126
QUALITIES = ["none", "coarse", "fine"]


def reader(port):
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", port))
    return udp


def messages(udp):
    """Yields the messages received so far."""
    udp.setblocking(False)
    with udp:
        while True:
            try:
                yield udp.recv(65536).decode()
            except BlockingIOError:
                return


config = Path(WORK, "flight.toml")
camera = '[camera]\nsource = "simulated"\nrate_hz = 10\n'
outputs = [f'[[output]]\nto = "udp:127.0.0.1:{port}"\nformat = "{form}"\n' for port, form in ((JSONL, "jsonl"), (NMEA, "nmea"))]
config.write_text(camera + "".join(outputs))
readers = [reader(port) for port in (JSONL, NMEA)]
subprocess.run([PROGRAM, "fly", "--config", config, "--duration", "3s"], check=True, capture_output=True)
lines, sentences = (list(messages(udp)) for udp in readers)
assert len(lines) == len(sentences) > 20, (len(lines), len(sentences))
fine = 0
for line, text in zip(lines, sentences):
    solution, sentence = json.loads(line), pynmea2.parse(text, check=True)
    assert len(text) <= 82 and text.endswith("\r\n"), text
    assert sentence.manufacturer == "SAS", text
    kind, utc, quality, azimuth, elevation, sigma, roll, roll_sigma, camera = sentence.data
    assert (kind, camera) == ("P", "1") and solution["camera"] == "camera", text
    assert utc == solution["utc"][11:22].replace(":", ""), (text, solution["utc"])
    assert QUALITIES[int(quality)] == solution["quality"], text
    assert roll == roll_sigma == "" and "roll_deg" not in solution, text
    offset = solution["offset_deg"]
    assert (offset is None) == (azimuth == ""), text
    if offset:
        sent = [float(azimuth), float(elevation), float(sigma)]
        expected = [offset["azimuth"], offset["elevation"], offset["sigma"]]
        assert all(abs(a - b) < 6e-7 for a, b in zip(sent, expected)), (text, offset)
        fine += quality == "2"
assert fine > 10, fine
print(f"{len(lines)} JSON lines and sentences, {fine} of fine frames: alike")
