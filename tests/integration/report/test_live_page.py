#!/usr/bin/env python3
"""The page of `pleat up --page`, over HTTP and in headless Chromium: SOURCE PLEAT. Without Chromium the first part alone."""

import http.client
import json
import os
import pathlib
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.parse
from array import array

SOURCE, PLEAT = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
sys.path.insert(0, str(SOURCE / "services/presentation/viewer"))

from browser import Browser, find_programs  # noqa: E402
from pictures import colors, decode_png, difference  # noqa: E402

FINE, COARSE = 11393, 749


def start_page(folder, *arguments):
    """`pleat up` with its page: the process, the page's address, the coordinator's."""
    up = subprocess.Popen([PLEAT, "up", "--page", "127.0.0.1:0", "--data", folder, *arguments], stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, text=True)
    page = None
    for line in up.stdout:
        if line.startswith("page "):
            page = line.split()[1]
        if line.startswith("ready "):
            return up, page, line.split()[1]
    raise RuntimeError(f"`pleat up` ended before it was ready, exit code {up.wait()}")


def unpack(body):
    """What services/presentation/live/packed.hpp describes: the object, and the arrays by name."""
    (size,) = struct.unpack_from("<I", body)
    about, place, arrays = json.loads(body[4 : 4 + size]), 4 + size, {}
    for entry in about["arrays"]:
        values = array({"float32": "f", "uint32": "I"}[entry["type"]])
        values.frombytes(body[place : place + 4 * entry["length"]])
        arrays[entry["name"]] = values
        place += 4 * entry["length"]
    assert place == len(body)
    return about, arrays


def eventually(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"not true after {seconds} s")
        time.sleep(0.05)
    return value


class LivePage(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.temporary.cleanup)
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.up, cls.page, cls.coordinator = start_page(cls.folder / "data")
        cls.addClassCleanup(cls.up.stdout.close)
        cls.addClassCleanup(cls.up.wait)
        cls.addClassCleanup(cls.up.kill)
        cls.url = urllib.parse.urlsplit(cls.page)
        cls.children = []

    def tearDown(self):
        for child in self.children:
            child.send_signal(signal.SIGINT)
            child.wait()
        self.children.clear()

    def ask(self, path, method="GET", headers=None, whole=False):
        """Status, headers and body; `path` below the token, unless `whole`."""
        connection = http.client.HTTPConnection(self.url.hostname, self.url.port, timeout=30)
        try:
            connection.putrequest(method, path if whole else self.url.path + path, skip_host=True)
            for name, value in (headers if headers is not None else {"Host": self.url.netloc}).items():
                connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            connection.close()

    def state(self):
        status, _, body = self.ask("state")
        self.assertEqual(status, 200)
        return json.loads(body)

    def run_in_background(self, *arguments):
        child = subprocess.Popen([PLEAT, *arguments, "--coordinator", self.coordinator, "-q"], stdout=subprocess.DEVNULL,
                                 stderr=subprocess.DEVNULL)
        self.children.append(child)
        return child

    def running(self, live):
        return next((job for job in self.state()["jobs"] if job["live"] == live and job["state"] == "running"
                     and job["frames_complete"] > 0), None)

    def frames_of(self, job):
        """Frames as a page would get them, to the end of the job."""
        path = "jobs/" + urllib.parse.quote(job, safe="")
        newest = -1
        while True:
            status, headers, body = self.ask(f"{path}/frame?after={newest}")
            if status == 404 or "Pleat-Over" in headers:
                return
            self.assertIn(status, (200, 204), body)
            if status == 200:
                about, arrays = unpack(body)
                self.assertGreater(about["index"], newest)
                newest = about["index"]
                yield about, arrays

    def test_who_has_not_the_token_is_refused(self):
        self.assertRegex(self.page, r"^http://127\.0\.0\.1:\d+/[0-9a-f]{32}/$")
        token = self.url.path.strip("/")
        other = "0" * 32 if token[0] != "0" else "1" * 32
        for path in ("/", "/state", f"/{other}/", f"/{other}/state", f"/{token[:-1]}/state", f"/{token}0/state", f"/{token}",
                     f"/{other}/jobs/x/frame", f"//{token}/state"):
            status, headers, body = self.ask(path, whole=True)
            self.assertEqual((path, status), (path, 403))
            self.assertNotIn(token, body.decode())
        status, headers, body = self.ask("")
        self.assertEqual(status, 200)
        self.assertIn("text/html", headers["Content-Type"])
        self.assertEqual(headers["Cache-Control"], "no-store")
        self.assertIn("frame-ancestors 'none'", headers["Content-Security-Policy"])
        self.assertIn(b"connect-src 'self'", body)

    def test_foreign_host_names_are_refused(self):
        port = self.url.port
        for headers in ({"Host": "evil.example"}, {"Host": f"evil.example:{port}"}, {"Host": f"127.0.0.1:{port}.evil.example"},
                        {"Host": "127.0.0.1"}, {"Host": f"127.0.0.1:{port + 1}"}, {"Host": ""}, {}):
            self.assertEqual((headers, self.ask("state", headers=headers)[0]), (headers, 421))
        self.assertEqual(self.ask("state", headers={"Host": f"localhost:{port}"})[0], 200)

    def test_nothing_can_be_changed_and_nothing_else_is_there(self):
        for method in ("POST", "PUT", "DELETE"):
            self.assertIn(self.ask("state", method)[0], (400, 404))
        self.assertIn(self.ask("../state")[0], (403, 404))
        self.assertEqual(self.ask("jobs/nobody/frame")[0], 404)
        self.assertEqual(self.ask("jobs/nobody/meshes")[0], 404)
        self.assertEqual(self.ask("jobs/..%2f..%2fetc/meshes")[0], 404)
        self.assertEqual(self.ask("jobs/x/frame?after=y")[0], 400)

    def test_only_this_host_listens(self):
        for address in ("0.0.0.0:0", "192.0.2.1:80", "unix:/tmp/page", "8050", "127.0.0.1:99999"):
            up = subprocess.run([PLEAT, "up", "--page", address], capture_output=True, text=True, timeout=60)
            self.assertEqual(up.returncode, 2, up.stderr)
            self.assertIn(f"--page {address}", up.stderr)
            self.assertEqual(len(up.stderr.splitlines()), 1, up.stderr)
        taken = subprocess.run([PLEAT, "up", "--page", self.url.netloc, "--data", self.folder / "other"],
                               capture_output=True, text=True, timeout=120)
        self.assertEqual(taken.returncode, 1, taken.stderr)
        self.assertIn(f"--page {self.url.netloc}", taken.stderr)

    def test_frames_of_a_job(self):
        self.run_in_background("run", "draping", "--frames", "60", "--out", self.folder / "job")
        job = eventually(lambda: self.running(live=False))
        self.assertEqual((job["scene"], job["frames"], job["coarse_vertices"], job["fine_vertices"], job["detail"]),
                         ("draping", 60, COARSE, FINE, "fold"))
        status, _, body = self.ask(f"jobs/{job['id']}/meshes")
        self.assertEqual(status, 200)
        about, meshes = unpack(body)
        self.assertEqual((about["coarse_vertices"], about["fine_vertices"]), (COARSE, FINE))
        self.assertEqual(max(meshes["coarse_faces"]), COARSE - 1)
        self.assertEqual(max(meshes["fine_faces"]), FINE - 1)
        count = 0
        for about, arrays in self.frames_of(job["id"]):
            count += 1
            self.assertEqual((len(arrays["coarse"]), len(arrays["fine"])), (3 * COARSE, 3 * FINE))
            self.assertEqual((about["error"], about["penetrations"], about["self_intersections"]), ("", 0, 0))
            self.assertIn("fold", [stage["name"] for stage in about["stages"]])
        self.assertGreater(count, 3)
        self.assertEqual(about["index"], 59)
        # What was shown last is what the job's own client has got.
        eventually(lambda: (self.folder / "job/report.json").exists())
        subprocess.run([PLEAT, "export", self.folder / "job/result.h5", "--format", "pc2", "--out", self.folder / "pc2", "-q"],
                       check=True, stdout=subprocess.DEVNULL)
        cache = next((self.folder / "pc2").glob("*.pc2")).read_bytes()
        self.assertEqual(cache[-12 * FINE :], arrays["fine"].tobytes())

    def test_frames_of_a_live_session_and_what_the_launcher_did(self):
        self.run_in_background("enhance", "--rest", SOURCE / "deploy/garments/tablecloth.obj", "--frames",
                               self.frames_of_a_wave(400), "--out", self.folder / "session")
        session = eventually(lambda: self.running(live=True))
        self.assertEqual((session["frames"], session["fine_vertices"], session["detail"]), (0, FINE, "fold"))
        frames = self.frames_of(session["id"])
        first = next(frames)[1]["fine"]
        for _ in range(5):
            about, arrays = next(frames)
        self.assertEqual(len(arrays["coarse"]), 3 * COARSE)
        self.assertNotEqual(arrays["fine"], first)
        self.assertEqual(self.state()["notes"], [])
        children = subprocess.run(["ps", "--ppid", str(self.up.pid), "-o", "pid=,args="], capture_output=True, text=True).stdout
        victim = next(int(line.split()[0]) for line in children.splitlines() if "pleat-conversion" in line)
        os.kill(victim, signal.SIGKILL)
        notes = eventually(lambda: self.state()["notes"])
        self.assertIn("conversion", notes[0])

    def frames_of_a_wave(self, count):
        """A PC2 cache of the tablecloth in waves."""
        text = (SOURCE / "deploy/garments/tablecloth.obj").read_text()
        points = [[float(word) for word in match] for match in re.findall(r"^v (\S+) (\S+) (\S+)", text, re.MULTILINE)]
        path = self.folder / "wave.pc2"
        with path.open("wb") as file:
            file.write(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, len(points), 0, 1, count))
            for k in range(count):
                lift = [0.03 * ((8 * x + 0.1 * k) % 2 - 1) ** 2 for x, _, _ in points]
                file.write(array("f", [v for (x, y, z), up in zip(points, lift) for v in (x, y + up, z)]).tobytes())
        return path

    @unittest.skipUnless(find_programs(), "no chromium or chromedriver")
    def test_in_a_browser(self):
        with Browser(1200, 720) as browser:
            browser.open(self.page)
            browser.wait("window.pleatLive")
            # Longer than anybody looks (it is cancelled), and never at rest.
            child = self.run_in_background("run", "flag", "--frames", "50000", "--out", self.folder / "seen")
            browser.wait("pleatLive.received > 2", 120)
            browser.run("pleatLive.following = false")
            held = browser.run("return pleatLive.frame")
            box = browser.run("const r = document.querySelectorAll('.view')[1].getBoundingClientRect();"
                              "return { x: r.x + 20, y: r.y + 60, width: r.width - 40, height: r.height - 80 }")
            first = decode_png(browser.screenshot(box))
            self.assertGreater(colors(first), 20)
            received = browser.run("return pleatLive.received")
            browser.wait(f"pleatLive.received > {received + 3}", 120)
            self.assertEqual(browser.run("return pleatLive.frame"), held)
            browser.run("pleatLive.following = true")
            browser.wait(f"pleatLive.frame > {held}", 120)

            def moved():  # by the next frame hardly, where many come a second
                browser.run("pleatLive.render()")
                return difference(first, decode_png(browser.screenshot(box))) > 0.01

            self.assertTrue(eventually(moved))
            child.send_signal(signal.SIGINT)
            browser.wait("pleatLive.jobs.some(job => job.id === pleatLive.selected && job.state === 'cancelled')", 120)
            text = browser.run("return document.getElementById('side').textContent")
            for shown in ("flag", "cancelled", "of 50,000 frames", "Fold", "Refinement"):
                self.assertIn(shown, text)
            errors = [entry["message"] for entry in browser.log("browser") if entry["level"] in ("SEVERE", "WARNING")]
            errors = [line for line in errors if "GPU stall due to ReadPixels" not in line]
            self.assertEqual(errors, [])
            requests = [json.loads(entry["message"])["message"] for entry in browser.log("performance")]
            urls = [m["params"]["request"]["url"] for m in requests if m["method"] == "Network.requestWillBeSent"]
            outside = [url for url in urls if not url.startswith((self.page, "data:", "blob:", "about:", "chrome:"))]
            self.assertEqual(outside, [])

    def test_a_coordinator_with_tokens(self):
        tokens, mine = self.folder / "tokens", self.folder / "watcher-token"
        tokens.write_text("alice user aaaaaaaaaaaaaaaa\nboard watcher bbbbbbbbbbbbbbbb\n")
        mine.write_text("bbbbbbbbbbbbbbbb\n")
        tokens.chmod(0o600)
        mine.chmod(0o600)
        arguments = ["--token-file", tokens, "--page-token-file", mine]
        up, page, _ = start_page(self.folder / "guarded", *arguments)
        try:
            url = urllib.parse.urlsplit(page)
            connection = http.client.HTTPConnection(url.hostname, url.port, timeout=30)
            connection.request("GET", url.path + "state")
            state = json.load(connection.getresponse())
            self.assertEqual((state["problem"], state["jobs"]), ("", []))
            connection.close()
        finally:
            up.send_signal(signal.SIGINT)
            self.assertEqual(up.wait(), 0)
            up.stdout.close()


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
