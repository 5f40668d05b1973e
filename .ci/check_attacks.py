"""Attacks the ground console: slow clients, a hostile archive, invalid frames, forged clocks and keywords.

During each attack every page must answer within a second, and the console's memory may grow by at most 50 MB.

Usage: check_attacks.py PROGRAM ARCHIVE WORKDIR. Needs nothing but Python.
"""

import contextlib
import http.client
import json
import pathlib
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.parse

PROGRAM, ARCHIVE, WORKDIR = sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
MOST_S, MOST_MB = 1.0, 50.0
DECADE_S = 315_360_000
SECRET = "nobody outside may read this"
ENDING = contextlib.ExitStack()


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as port:
        port.bind(("127.0.0.1", 0))
        return port.getsockname()[1]


class Console:
    """A console for a data source, with its log in WORKDIR."""

    def __init__(self, name, source, *arguments):
        self.port = free_port(socket.SOCK_STREAM)
        self.log = WORKDIR / f"{name}.log"
        with self.log.open("wb") as log:
            command = [PROGRAM, "console", source, "--listen", f"127.0.0.1:{self.port}", *map(str, arguments)]
            self.process = subprocess.Popen(command, stdout=log, stderr=log, cwd=WORKDIR)
        ENDING.callback(self.end)
        self.slowest_s, self.asked = 0.0, 0
        end = time.monotonic() + 20
        while True:
            try:
                self.get("/api/flight")
                break
            except OSError:
                assert time.monotonic() < end, f"{name}: no answer, see {self.log}"
                time.sleep(0.05)
        self.slowest_s, self.asked = 0.0, 0
        self.before_mb = self.memory_mb()

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(20)
        assert "panic" not in self.log.read_text(errors="replace"), f"a panic: see {self.log}"

    def memory_mb(self):
        status = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) / 1024

    def get(self, path, address="127.0.0.1"):
        """Status and body of an answer; the request comes from `address`, one of this machine's."""
        begun = time.monotonic()
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20, source_address=(address, 0))
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()
            self.slowest_s, self.asked = max(self.slowest_s, time.monotonic() - begun), self.asked + 1

    def pages(self, *more, address="127.0.0.1"):
        """Asserts that every page answers."""
        for path in ("/", "/plots", "/commands", "/frames", "/api/flight", "/api/now", "/api/frames", "/api/commands", *more):
            status, _ = self.get(path, address)
            assert status == 200, f"{path}: {status}"

    def holds(self, attack):
        more_mb = self.memory_mb() - self.before_mb
        print(f"{attack}: {self.asked} answers, the slowest after {self.slowest_s:.2f} s; {more_mb:+.1f} MB")
        assert self.slowest_s < MOST_S, f"expected every answer within {MOST_S} s"
        assert more_mb < MOST_MB, f"expected less than {MOST_MB} MB more"
        self.slowest_s, self.asked = 0.0, 0


# ---- a hostile archive


def hostile_archive():
    """A copy of an archive whose log names files that are not its frames."""
    archive = WORKDIR / "hostile"
    shutil.copytree(ARCHIVE, archive)
    (WORKDIR / "secret.txt").write_text(SECRET)
    (archive / "link.fits").symlink_to("../secret.txt")
    (archive / "etc").symlink_to("/etc")
    names = ["../secret.txt", "/etc/passwd", "link.fits", "etc/passwd", "/dev/zero", "/proc/self/environ", "20130921T18", "pipe.fits"]
    subprocess.run(["mkfifo", archive / "pipe.fits", archive / "solutions_pipe.csv"], check=True)
    log = next(path for path in archive.glob("solutions_2*.csv"))
    rows = log.read_text().splitlines()
    good = rows[1].split(",")
    with log.open("a") as out:
        for name in names:
            out.write(",".join([good[0], name, *good[2:]]) + "\n")
    return archive, names, good[1]


def a_hostile_archive_shows_its_frames_alone():
    archive, names, good = hostile_archive()
    console = Console("hostile", f"archive:{archive}")
    frames = [f"/api/frame.{kind}?file={urllib.parse.quote(good)}" for kind in ("fits", "png")]
    end = time.monotonic() + 20
    while console.get(frames[0])[0] != 200:
        assert time.monotonic() < end, "the good frame is not there"
    console.pages(*frames)
    console.slowest_s, console.asked, console.before_mb = 0.0, 0, console.memory_mb()
    for name in names:
        for kind in ("fits", "png"):
            status, body = console.get(f"/api/frame.{kind}?file={urllib.parse.quote(name)}")
            assert 400 <= status < 600, f"{name}: {status}"
            assert SECRET.encode() not in body and b"root:" not in body, f"{name} was served"
    console.holds(f"{len(names)} names out of the archive")
    answers = []
    ask = lambda: answers.append(console.get("/api/frame.png?file=pipe.fits")[0])
    askers = [threading.Thread(target=ask) for _ in range(44)]
    for asker in askers:
        asker.start()
    console.pages(*frames)
    for asker in askers:
        asker.join()
    assert len(answers) == 44 and all(400 <= status < 600 for status in answers), answers
    console.holds("44 requests for a frame that is a pipe")


# ---- slow clients


def slow_post(console, address, over):
    """Sends a request with a body of one byte every 3 s, and repeats it when the connection is closed."""
    while not over.is_set():
        try:
            with socket.socket() as client:
                client.bind((address, 0))
                client.settimeout(5)
                client.connect(("127.0.0.1", console.port))
                head = f"POST /api/login HTTP/1.1\r\nHost: 127.0.0.1:{console.port}\r\nContent-Length: 1000\r\n\r\n"
                client.sendall(head.encode())
                while not over.wait(3):
                    client.sendall(b"x")
        except OSError:
            over.wait(0.5)


def slow_clients_keep_nobody_out():
    console = Console("slow", f"archive:{ARCHIVE}")
    console.pages()
    console.slowest_s, console.asked = 0.0, 0
    over = threading.Event()
    clients = [threading.Thread(target=slow_post, args=(console, "127.0.0.1", over)) for _ in range(512)]
    for client in clients:
        client.start()
    time.sleep(2)
    for _ in range(12):
        console.pages(address="127.0.0.2")
        slowest = console.slowest_s, console.asked
        retried(lambda: console.pages(address="127.0.0.1"))
        console.slowest_s, console.asked = slowest
        time.sleep(1)
    console.holds("512 slow bodies, seen from another address")
    over.set()
    for client in clients:
        client.join()


def retried(ask):
    """Repeats a request from the attacking address: that address gets at most half of the connections, which displace each other."""
    for _ in range(20):
        try:
            return ask()
        except OSError:
            time.sleep(0.1)
    return ask()


# ---- forged packets


def checked(kind, payload, seconds):
    """A telemetry packet: CRC-16/MODBUS, high byte first."""
    packet = bytearray(struct.pack("<HBBHHII", 0xC39A, kind, 0x30, len(payload), 0, 0, seconds) + payload)
    crc = 0xFFFF
    for byte in packet:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    packet[6:8] = struct.pack(">H", crc)
    return bytes(packet)


def housekeeping(seconds, uptime_s):
    """Housekeeping in its first layout; all fields are zero except those that a page needs."""
    payload = bytearray(UPTIME_AT + 4)
    payload[0] = 1
    payload[UPTIME_AT:UPTIME_AT + 4] = struct.pack("<I", uptime_s)
    return checked(0x70, bytes(payload) + bytes(FIRST_LAYOUT - len(payload)), seconds)


def field_places():
    """Offsets, from the protocol page, of the uptime and of the end of the first layout."""
    page = pathlib.Path("docs/protocol.md").read_text().splitlines()
    rows = [line.split("|") for line in page if line.startswith("| ") and line.count("|") == 6]
    places = {row[2].strip(" `"): int(row[1]) for row in rows if row[1].strip().isdigit()}
    return places["uptime_s"], places["takeovers"]


UPTIME_AT, FIRST_LAYOUT = field_places()


def forged_packets_forget_nothing():
    port = free_port(socket.SOCK_DGRAM)
    console = Console("forged", f"udp:127.0.0.1:{port}")
    now = int(time.time())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        send = lambda packet: line.sendto(packet, ("127.0.0.1", port))
        for second in range(5):
            send(housekeeping(now + second, second))
            time.sleep(1)
        for second in (5, 6):
            send(housekeeping(now + second + DECADE_S, second))
        time.sleep(0.5)
        send(housekeeping(now + 7, 7))
        time.sleep(0.5)
        console.pages()
        line_counts = json.loads(console.get("/api/now")[1])["state"]["line"]
        assert line_counts["missing"] < 100, line_counts
        assert line_counts["doubtful"] == 2, line_counts
        status, table = console.get("/api/table.csv?fields=housekeeping.uptime_s")
        rows = table.decode().splitlines()
        assert status == 200 and len(rows) >= 7, f"the history was wiped: {rows}"
        console.holds("two packets of another decade")
        for number in range(40_000):
            tag = struct.pack("<iiiiBB8s", 1, 0, 0, 0, 41, 1, f"K{number:07}".encode()[:8]) + bytes(32)
            send(checked(0x83, tag, now))
            if number % 200 == 0:
                console.get("/api/now")
                time.sleep(0.01)
        time.sleep(1)
        answer = console.get("/api/now")[1]
        assert len(answer) < 100_000, f"/api/now has {len(answer)} bytes"
        console.pages()
        console.holds("40,000 forged keywords")


with ENDING:
    WORKDIR.mkdir(parents=True, exist_ok=True)
    a_hostile_archive_shows_its_frames_alone()
    slow_clients_keep_nobody_out()
    forged_packets_forget_nothing()
