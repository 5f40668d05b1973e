"""Runs `solaspect refine s3://...` on an S3 server on this machine, through a proxy that counts requests and injects faults.

Usage: check_objects.py PROGRAM ARCHIVE WORKDIR. PROGRAM is built with --features object-store. Needs moto[server] and boto3.
"""

import contextlib
import csv
import http.client
import logging
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

import boto3
from moto.server import ThreadedMotoServer

PROGRAM, ARCHIVE, WORKDIR = [pathlib.Path(argument).resolve() for argument in sys.argv[1:4]]
# The report names the archive, so folder and prefix have the same name.
FLIGHT = WORKDIR / "flight"
EMPTY = WORKDIR / "empty"
BUCKET, URL = "balloon", "s3://balloon/flight"
HEADER_BYTES = 65536
# Number of objects on a page of a listing, so small that a listing has several pages.
PAGE = 100
# Number of frames that may be in transit when the program is killed.
UNDER_WAY = 16 * len(os.sched_getaffinity(0))
LIMIT_S = 400
CUT, CLOSED = "cut in the middle", "closed before the answer"
REFUSALS = {"SlowDown": 503, "InternalError": 500, "NoSuchKey": 404, "AccessDenied": 403}
ENDING = contextlib.ExitStack()


def expect(is_so, expected, found):
    if not is_so:
        raise AssertionError(f"expected {expected}, found {found}")


# ---- the proxy


@dataclass
class Request:
    target: str
    key: str
    header: str | None
    attempt: int
    fault: str | None = None
    sent: int = 0

    def is_frame(self):
        return self.key.endswith(".fits")

    def is_whole(self):
        return self.is_frame() and not self.header

    def is_list(self):
        return "list-type=2" in self.target

    def range(self):
        """First and last requested byte; the last is None for a whole object."""
        first, _, last = (self.header or "bytes=0-").removeprefix("bytes=").partition("-")
        return int(first), int(last) if last else None


class Proxy(ThreadingHTTPServer):
    """Forwards requests to the storage. `fault` returns the fault of a request: None, CUT, CLOSED, or one of REFUSALS."""

    daemon_threads = True
    request_queue_size = 256

    def __init__(self, fault, delay_s):
        super().__init__(("127.0.0.1", 0), Handler)
        self.fault, self.delay_s = fault, delay_s
        self.requests, self.attempts, self.lock = [], Counter(), threading.RLock()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def note(self, target, header):
        key = unquote(target.partition("?")[0]).removeprefix(f"/{BUCKET}").removeprefix("/")
        with self.lock:
            request = Request(target, key, header, self.attempts[target, header])
            self.attempts[target, header] += 1
            request.fault = self.fault(self, request)
            self.requests.append(request)
        return request

    def whole(self):
        """Number of requests for each whole frame."""
        with self.lock:
            return Counter(request.key for request in self.requests if request.is_whole())

    def handle_error(self, *arguments):
        # A killed program leaves open connections.
        if not isinstance(sys.exception(), OSError):
            super().handle_error(*arguments)

    def end(self):
        self.shutdown()
        self.server_close()


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    wbufsize = -1
    storage = None

    def do_GET(self):
        request = self.server.note(self.path, self.headers["Range"])
        time.sleep(self.server.delay_s)
        if request.fault == CLOSED:
            self.close_connection = True
            return
        status, headers, body = self.refuse(request) if request.fault in REFUSALS else self.ask(request)
        if request.fault == CUT:
            body, self.close_connection = body[:len(body) // 2], True
        request.sent = len(body)
        self.send_response_only(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def refuse(self, request):
        body = f"<?xml version=\"1.0\"?><Error><Code>{request.fault}</Code><Message>As the check wants it.</Message></Error>".encode()
        return REFUSALS[request.fault], {"Content-Type": "application/xml", "Content-Length": len(body)}, body

    def ask(self, request):
        self.storage = self.storage or http.client.HTTPConnection(*STORAGE)
        self.storage.request("GET", self.path + f"&max-keys={PAGE}" * request.is_list(), headers=dict(self.headers))
        answer = self.storage.getresponse()
        headers = {name: value for name, value in answer.getheaders() if name.lower() not in ("connection", "transfer-encoding")}
        body = answer.read()
        return answer.status, {"Content-Length": len(body)} | headers, body

    def finish(self):
        if self.storage:
            self.storage.close()
        super().finish()


def some_fault(_proxy, request):
    """Faults for a fifth of the requests, independent of their order, at most two for each; and each page of a listing is cut once."""
    if request.attempt >= 2:
        return None
    if request.is_list() and request.attempt == 0:
        return CUT
    chance = random.Random(f"{request.target} {request.header} {request.attempt}")
    return chance.choice(["SlowDown", "InternalError", CLOSED, CUT]) if chance.random() < 0.2 else None


# ---- the program


class Refine:
    """`solaspect refine`, monitored while it runs: it must keep no copy of the frames."""

    most_bytes = checks = 0

    def __init__(self, out, *arguments, url=URL, fault=lambda *_: None, delay_s=0):
        self.out, self.log = WORKDIR / out, WORKDIR / f"{out}.log"
        self.proxy = Proxy(fault, delay_s)
        ENDING.callback(self.proxy.end)
        storage = {"AWS_ACCESS_KEY_ID": "check", "AWS_SECRET_ACCESS_KEY": "check", "AWS_REGION": "us-east-1", "AWS_ALLOW_HTTP": "true",
                   "AWS_ENDPOINT": f"http://127.0.0.1:{self.proxy.server_port}"}
        folders = dict.fromkeys(("TMPDIR", "HOME", "XDG_CACHE_HOME"), str(EMPTY))
        self.begun = time.monotonic()
        with self.log.open("w") as log:
            self.process = subprocess.Popen([PROGRAM, "refine", url, "--out", self.out, *map(str, arguments)], env=os.environ | storage | folders,
                                            cwd=EMPTY, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log)
        ENDING.callback(self.process.kill)

    def watch(self):
        copies = [str(path) for path in EMPTY.iterdir()]
        with contextlib.suppress(FileNotFoundError):
            files = [path for path in self.out.rglob("*") if path.is_file()]
            copies += [str(path) for path in files if any(name in path.name for name in NAMES)]
            Refine.most_bytes = max(Refine.most_bytes, sum(path.stat().st_size for path in files))
        # A deleted file is visible among the open ones.
        with contextlib.suppress(OSError):
            links = [os.readlink(link) for link in pathlib.Path(f"/proc/{self.process.pid}/fd").iterdir()]
            copies += [link for link in links if link.endswith("(deleted)")]
        expect(not copies, "no copy of a frame", copies)
        Refine.checks += 1

    def finish(self, code=0, kill_at=None):
        while self.process.poll() is None:
            self.watch()
            expect(time.monotonic() < self.begun + LIMIT_S, f"an end of {self.log.stem} within {LIMIT_S} s", self.log.read_text().strip())
            if kill_at and len(self.proxy.whole()) >= kill_at:
                self.process.kill()
            time.sleep(0.02)
        self.seconds = time.monotonic() - self.begun
        self.watch()
        self.proxy.end()
        self.requests, self.whole, self.message = self.proxy.requests, self.proxy.whole(), self.log.read_text().strip()
        self.frames, self.again = set(self.whole), {frame for frame, count in self.whole.items() if count > 1}
        self.headers = [request for request in self.requests if request.is_frame() and not request.is_whole()]
        found = self.process.returncode
        expect(found == code and "panicked" not in self.message, f"exit code {code} of {self.log.stem}", f"{found}: {self.message}")
        return self

    def tables(self):
        """All output files except the journals."""
        files = [path for path in self.out.rglob("*") if path.is_file() and path.suffix != ".journal"]
        return {str(path.relative_to(self.out)): path.read_bytes() for path in files}

    def expect_same(self, other):
        ours, theirs = self.tables(), other.tables()
        expect(ours.keys() == theirs.keys() and "aspect.fits" in ours, f"in {self.log.stem} {sorted(theirs)}", sorted(ours))
        differ = [name for name in ours if ours[name] != theirs[name]]
        expect(not differ, f"in {self.log.stem} the bytes of {other.log.stem}", f"others in {differ}")


# ---- the archive


def key(path):
    return str(path.relative_to(WORKDIR))


def upload(paths):
    client = boto3.client("s3", endpoint_url="http://{}:{}".format(*STORAGE), region_name="us-east-1", aws_access_key_id="check",
                          aws_secret_access_key="check")
    with contextlib.closing(client), ThreadPoolExecutor(8) as pool:
        client.create_bucket(Bucket=BUCKET)
        objects = {key(path): path.read_bytes() for path in paths}
        # Objects that are not part of the flight: another flight, and a folder object as web consoles of object storage make them.
        objects |= {"flight2/other.fits": b"another flight", "empty/readme.txt": b"no frames", "flight/": b""}
        list(pool.map(lambda name: client.put_object(Bucket=BUCKET, Key=name, Body=objects[name]), objects))


# ---- the checks


def same_bytes():
    clean.expect_same(folder)
    tables = clean.tables()
    return f"{len(FRAMES)} frames; {', '.join(sorted(tables))}: {sum(map(len, tables.values()))} bytes"


def ranged_reads():
    ranges = [request.range() for request in clean.headers]
    expect(all(last - first < HEADER_BYTES for first, last in ranges), f"headers in ranges of up to {HEADER_BYTES} bytes", ranges[:3])
    expect(clean.frames == FRAMES, "every frame fetched", f"not {sorted(FRAMES - clean.frames)[:3]}")
    expect(max(clean.whole.values()) <= 3, "no frame fetched more than three times: solved, solved again, shown", clean.whole.most_common(3))
    sent = sum(request.sent for request in clean.requests)
    return f"{len(ranges)} headers, {len(FRAMES)} frames, {len(clean.again)} of them twice; moved {sent / 1e6:.1f} MB, " \
           f"{sent / ARCHIVE_BYTES:.3f} of the archive"


def merged_shards():
    shards = [Refine(f"shard-{number}", "--shard", f"{number}/2") for number in (1, 2)]
    first, second = (shard.finish().frames for shard in shards)
    expect(first | second == FRAMES and not first & second, "every frame in one of two shards", f"{len(first)} and {len(second)}")
    merged = Refine("merged", "--merge", *(shard.out for shard in shards)).finish()
    merged.expect_same(folder)
    expect(merged.frames <= clean.again, f"only frames of the second solution and of pictures fetched again, {len(clean.again)}", len(merged.frames))
    expect(not merged.headers, "no header read again", len(merged.headers))
    return f"{len(first)} and {len(second)} frames; the merge fetched {len(merged.frames)} frames and {len(merged.headers)} headers"


def retries():
    run = Refine("retried", fault=some_fault).finish()
    run.expect_same(folder)
    faults = Counter(request.fault for request in run.requests if request.fault)
    repeated = len(run.requests) - len(clean.requests)
    expect(repeated >= faults.total(), f"a repeated request for each of {faults.total()} faults", repeated)
    asked = {(request.key, request.range()[0]) for request in run.requests}
    cut = [(request.key, request.range()[0] + request.sent) for request in run.requests if request.fault == CUT and request.is_frame()]
    again = [where for where in cut if where not in asked]
    expect(cut and not again, f"{len(cut)} frames and headers continued from where they were cut", f"{len(again)} not: {again[:3]}")
    kinds = ", ".join(f"{count} {fault}" for fault, count in faults.most_common())
    return f"{kinds} of {len(run.requests)} requests; {repeated} repeated; {run.seconds:.1f} s, {clean.seconds:.1f} s without"


def resumed():
    killed = Refine("resumed").finish(-signal.SIGKILL, kill_at=len(FRAMES) // 2)
    missing = FRAMES - killed.frames
    run = Refine("resumed").finish()
    run.expect_same(folder)
    expect(missing <= run.frames, f"{len(missing)} missing frames fetched", f"{len(missing - run.frames)} not")
    twice = run.frames & killed.frames - clean.again
    expect(len(twice) <= UNDER_WAY, f"at most {UNDER_WAY} frames, which were under way, fetched again", len(twice))
    return f"killed after {len(killed.frames)} frames; then {len(run.frames)} fetched, {len(twice)} of them had been under way"


def errors_of_a_person():
    cases = {"no bucket": ("s3://nobody/flight", None), "no frames": ("s3://balloon/empty", None), "no such scheme": ("ftp://balloon/flight", None),
             "no rights": (URL, "AccessDenied")}
    longest_s = 0
    for name, (url, fault) in cases.items():
        run = Refine(name, url=url, fault=lambda *_, fault=fault: fault).finish(1)
        expect(len(run.message.splitlines()) == 1 and url in run.message, f"for {name} one line that names {url}", run.message)
        expect(len(run.requests) <= 1, f"for {name} no request repeated", len(run.requests))
        longest_s = max(longest_s, run.seconds)
    return f"{', '.join(cases)}: a line each, within {longest_s:.1f} s"


def speed():
    rates = []
    for delay_s in (0, 0.05):
        for jobs in (["--jobs", 2], []):
            run = Refine(f"speed-{len(rates)}", "--shard", "1/4", *jobs, delay_s=delay_s).finish()
            rates.append(f"{len(run.frames) / run.seconds:.0f}/s ({'--jobs 2' if jobs else 'default'}, {delay_s * 1e3:.0f} ms)")
    return f"frames of a shard: {', '.join(rates)}"


def gone_in_the_middle(proxy, _request):
    return CLOSED if proxy.whole().total() > len(FRAMES) // 3 else None


def storage_gone():
    gone = going.result()
    expect(URL in gone.message, f"a message that names {URL}", gone.message)
    run = Refine("gone").finish()
    run.expect_same(folder)
    return f"after {len(gone.frames)} frames; ended after {gone.seconds:.1f} s, with {gone.message!r}; then {len(run.frames)} frames fetched"


def unreadable_rows():
    """Must come last, because it changes the archive."""
    garbage, short, empty, gone = broken = [path for path in PATHS if path.parts[-3] != "roll"][3:19:5]
    garbage.write_bytes(random.Random(4).randbytes(garbage.stat().st_size))
    short.write_bytes(short.read_bytes()[:short.stat().st_size // 2])
    empty.write_bytes(b"")
    upload(broken)
    local = Refine("broken-folder", url=FLIGHT).finish()
    lacking = Refine("broken", fault=lambda _, request: "NoSuchKey" if request.key == key(gone) else None).finish(1)
    with open(lacking.out / "aspect.csv", newline="") as file:
        rows = {row["FILE"]: row for row in csv.DictReader(file)}
    for path in broken:
        row = rows.get(str(path.relative_to(FLIGHT)))
        expect(row and row["QUALITY"] == "none" and row["REASON"], f"a row with a reason for {path.name}", row)
    run = Refine("broken").finish()
    run.expect_same(local)
    expect(key(gone) in run.frames, f"{gone.name} fetched once it is there", sorted(run.frames))
    more = run.frames - lacking.again - set(map(key, broken))
    expect(len(more) <= len(FRAMES) // 10, "few other frames fetched again", sorted(more))
    return f"garbage, cut, empty, missing; {len(run.frames)} frames fetched once the missing one was there"


def no_copy():
    expect(Refine.most_bytes < ARCHIVE_BYTES / 20, "less than 5 % of the archive in --out", f"{Refine.most_bytes} of {ARCHIVE_BYTES} bytes")
    return f"{Refine.checks} checks; at most {Refine.most_bytes / ARCHIVE_BYTES:.4f} of the archive in --out"


with ENDING:
    EMPTY.mkdir(parents=True)
    shutil.copytree(ARCHIVE, FLIGHT, symlinks=True)
    PATHS = sorted(FLIGHT.rglob("*.fits"))
    FRAMES, NAMES = set(map(key, PATHS)), {path.stem for path in PATHS}
    ARCHIVE_BYTES = sum(path.stat().st_size for path in PATHS)
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    ENDING.callback(server.stop)
    STORAGE = server.get_host_and_port()
    upload([path for path in FLIGHT.rglob("*") if path.is_file()])
    folder = Refine("folder", url=FLIGHT).finish()
    clean = Refine("clean").finish()
    # Runs in parallel with the others, because it waits most of the time.
    going = ENDING.enter_context(ThreadPoolExecutor()).submit(Refine("gone", fault=gone_in_the_middle).finish, 1)
    for promise in (same_bytes, ranged_reads, merged_shards, retries, resumed, errors_of_a_person, speed, storage_gone, unreadable_rows, no_copy):
        name = promise.__name__.replace("_", " ")
        try:
            begun = time.monotonic()
            print(f"{name}: {promise()} ({time.monotonic() - begun:.1f} s)", flush=True)
        except AssertionError as error:
            sys.exit(f"{name}: {error}")
