"""Opens report.html in headless Chromium and uses it as a person would.

    browser_test.py SOURCE_DIR FIXTURE_PROGRAM

FIXTURE_PROGRAM writes a report. Exit code 77 (skipped for CTest) if Chromium is not installed.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(sys.argv[1])
FIXTURE = sys.argv[2]
FRAMES = 30
sys.path.insert(0, str(SOURCE / "services/presentation/viewer"))

from browser import Browser, find_programs  # noqa: E402
from pictures import colors, decode_png, difference  # noqa: E402


def make_report(folder, *arguments):
    subprocess.run([FIXTURE, folder, str(FRAMES), *arguments], check=True, cwd=SOURCE)
    return pathlib.Path(folder) / "report.html"


class ReportTest(unittest.TestCase):
    """One browser for all tests. They share an opened page where they can: software rendering takes seconds to start."""

    opened = None

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="pleat-report-")
        cls.addClassCleanup(cls.folder.cleanup)
        cls.report = make_report(cls.folder.name + "/full")
        cls.plain = make_report(cls.folder.name + "/plain", "plain")
        cls.browser = Browser(1000, 640)
        cls.addClassCleanup(cls.browser.close)

    def open(self, report):
        """Opens the page anew."""
        for kind in ("browser", "performance"):
            self.browser.log(kind)
        type(self).opened = None
        self.browser.open(report)
        self.browser.wait("window.pleatReport && (pleatReport.ready || pleatReport.error)", 120)
        self.assertIsNone(self.browser.run("return pleatReport.error"))
        type(self).opened = report

    def use(self, report):
        """Brings the page to its state after opening, paused."""
        if self.opened != report:
            self.open(report)
        self.browser.run(
            "const r = pleatReport; r.playing = false; r.frame = 0; r.solo = null; r.wireframe = false; r.setCamera();"
            "document.activeElement.blur()"
        )

    def picture(self, view):
        """The pixels of a view's panel, after the browser has drawn."""
        index = self.browser.run("return pleatReport.views.indexOf(arguments[0])", view)
        self.browser.devtools(
            "Runtime.evaluate",
            {
                "expression": "new Promise(d => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(d))))",
                "awaitPromise": True,
            },
        )
        box = self.browser.run(
            "const r = document.querySelectorAll('.view')[arguments[0]].getBoundingClientRect();"
            "return { x: r.x + 40, y: r.y + 60, width: r.width - 130, height: r.height - 110 }",
            index,
        )
        return decode_png(self.browser.screenshot(box))

    def test_opens_without_errors_and_requests(self):
        self.open(self.report)
        first = self.browser.run("return pleatReport.frame")
        self.browser.wait(f"pleatReport.frame !== {first}", 120)  # it plays, so drawing runs as well
        errors = [entry for entry in self.browser.log("browser") if entry["level"] in ("SEVERE", "WARNING")]
        # Chromium itself remarks on reading pixels back from a software renderer.
        errors = [entry for entry in errors if "GPU stall due to ReadPixels" not in entry["message"]]
        self.assertEqual(errors, [])
        requests = []
        for entry in self.browser.log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated"):
                params = message["params"]
                requests.append(params.get("url") or params["request"]["url"])
        outside = [url for url in requests if not url.startswith(("file:", "data:", "blob:"))]
        self.assertEqual(outside, [])
        pages = [url for url in requests if url.startswith("file:")]
        self.assertEqual(len(pages), 1, pages)

    def test_every_view_shows_cloth(self):
        self.use(self.report)
        self.assertEqual(self.browser.run("return pleatReport.views"), ["coarse", "enhanced", "reference", "map"])
        self.browser.run("pleatReport.frame = arguments[0]", FRAMES - 1)
        pictures = {view: self.picture(view) for view in ("coarse", "enhanced", "reference", "map")}
        for view, picture in pictures.items():
            self.assertGreater(colors(picture), 40, view)
        # The wrinkles of the enhanced cloth are visible, and the reference is another mesh.
        self.assertGreater(difference(pictures["coarse"], pictures["enhanced"]), 0.03)
        self.assertGreater(difference(pictures["enhanced"], pictures["map"]), 0.10)

    def test_time_line_moves_the_cloth(self):
        self.use(self.report)
        self.assertEqual(self.browser.run("return pleatReport.frameCount"), FRAMES)
        seen = {}
        for frame in (0, FRAMES // 2, FRAMES - 1):
            self.browser.run(
                "const s = document.getElementById('slider'); s.value = arguments[0];"
                "s.dispatchEvent(new Event('input', { bubbles: true }))",
                frame,
            )
            self.assertEqual(self.browser.run("return pleatReport.frame"), frame)
            self.assertIn(f"Frame {frame} /", self.browser.run("return document.getElementById('frame').textContent"))
            seen[frame] = {view: self.picture(view) for view in ("coarse", "enhanced", "reference")}
        for view in ("coarse", "enhanced", "reference"):
            self.assertGreater(difference(seen[0][view], seen[FRAMES // 2][view]), 0.05, view)
            self.assertGreater(difference(seen[FRAMES // 2][view], seen[FRAMES - 1][view]), 0.05, view)

    def test_frames_do_not_change_by_looking(self):
        self.use(self.report)
        self.browser.run("pleatReport.frame = 10")
        before = self.picture("enhanced")
        self.browser.run("pleatReport.frame = 20")
        self.browser.run("pleatReport.frame = 10")
        self.assertLess(difference(before, self.picture("enhanced")), 0.001)

    def test_keyboard_and_player(self):
        self.use(self.report)
        self.browser.run("pleatReport.frame = 5")
        self.browser.press("\ue014")  # right
        self.assertEqual(self.browser.run("return pleatReport.frame"), 6)
        self.browser.press("\ue011")  # home
        self.assertEqual(self.browser.run("return pleatReport.frame"), 0)
        self.browser.press("\ue010")  # end
        self.assertEqual(self.browser.run("return pleatReport.frame"), FRAMES - 1)
        self.browser.press("2")
        self.assertEqual(self.browser.run("return pleatReport.solo"), "enhanced")
        self.browser.press("\ue00c")  # escape
        self.assertIsNone(self.browser.run("return pleatReport.solo"))
        self.browser.press(" ")
        self.assertTrue(self.browser.run("return pleatReport.playing"))
        self.browser.wait(f"pleatReport.frame !== {FRAMES - 1}", 120)
        self.browser.run("pleatReport.playing = false")

    def test_cameras_are_linked(self):
        self.use(self.report)
        self.browser.run("pleatReport.frame = arguments[0]", FRAMES - 1)
        before = {view: self.picture(view) for view in ("coarse", "map")}
        x, y = self.browser.run(
            "const r = document.querySelectorAll('.view')[1].getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]"
        )
        self.browser.drag((x, y), (x + 90, y + 10))  # in the enhanced view
        for view, picture in before.items():
            self.assertGreater(difference(picture, self.picture(view)), 0.05, view)

    def test_charts_and_figures(self):
        self.use(self.report)
        figures = json.loads((self.report.parent / "report.json").read_text())
        for chart in ("stage-chart", "distance-chart"):
            box = self.browser.run(
                "const r = document.getElementById(arguments[0]).getBoundingClientRect();"
                "return { x: r.x, y: r.y, width: r.width, height: r.height }",
                chart,
            )
            self.assertGreater(box["width"] * box["height"], 10000)
            self.assertGreater(colors(decode_png(self.browser.screenshot(box))), 5, chart)
        text = self.browser.run("return document.getElementById('side').textContent")
        self.assertIn("11,393 vertices", text)
        for name, stage in figures["stages"].items():
            self.assertIn(f"{stage['median_ms']:.2f}", text, name)
            self.assertIn(f"{stage['p95_ms']:.2f}", text, name)
        # The page computes the distance from its quantised frames, the library from the stored ones.
        shown = self.browser.run("return pleatReport.distances('enhanced')")
        self.assertEqual(len(shown), FRAMES)
        mean_square = sum(value * value for value in shown) / FRAMES
        expected = figures["fidelity"]["enhanced"]["rmse_m"]
        self.assertAlmostEqual(mean_square**0.5, expected, delta=0.02 * expected)

    def test_without_a_reference_the_added_detail_is_shown(self):
        self.use(self.plain)
        self.assertEqual(self.browser.run("return pleatReport.views"), ["coarse", "enhanced", "map"])
        self.assertEqual(self.browser.run("return pleatReport.map"), "detail")
        self.browser.run("pleatReport.frame = arguments[0]", FRAMES - 1)
        self.assertGreater(colors(self.picture("map")), 40)

    def test_a_body_is_skinned_in_the_page(self):
        self.use(self.plain)

        def place(frame):
            return self.browser.run("pleatReport.frame = arguments[0]; return pleatReport.obstacle(1)", frame)

        # Vertices 0, 3 and 6 are 5 cm beside the pole's foot, middle and top.
        self.assert_near(place(0), {0: (0.75, 0, 0), 3: (0.75, 0.4, 0), 6: (0.75, 0.8, 0)})
        # The upper half has turned by a quarter to the left; the middle ring is the mean of two.
        last = place(FRAMES - 1)
        self.assert_near(last, {0: (0.75, 0, 0), 3: (0.725, 0.425, 0), 6: (0.3, 0.45, 0)})
        # In this frame it was recorded higher than its joints say.
        self.assert_near(place(10), {0: (0.75, 0.25, 0)})
        self.assert_near(place(11), {0: (0.75, 0, 0)})

    def assert_near(self, positions, expected):
        for vertex, point in expected.items():
            for axis in range(3):
                self.assertAlmostEqual(positions[3 * vertex + axis], point[axis], delta=2e-4)

    def test_a_damaged_page_says_so(self):
        damaged = self.report.parent / "damaged.html"
        text = self.report.read_text()
        start = text.index(">", text.index('id="pleat-enhanced"')) + 1
        damaged.write_text(text[: start + 1000] + text[text.index("</script>", start) :])
        type(self).opened = None
        self.browser.open(damaged)
        self.browser.wait("window.pleatReport && pleatReport.error")
        notice = self.browser.run("const n = document.getElementById('notice'); return n.hidden ? '' : n.textContent")
        self.assertIn("can't be shown", notice)


if __name__ == "__main__":
    if find_programs() is None:
        print("skipped: chromium or chromedriver is not installed (`make setup` installs them)")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
