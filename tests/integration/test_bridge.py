#!/usr/bin/python3
"""`pleat bridge`, spoken to by the modules of the add-on for Blender that need no Blender: SOURCE PLEAT. Exit code 77:
numpy is missing."""
import importlib.util
import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

if not importlib.util.find_spec("numpy"):
    print("skipped: no numpy")
    sys.exit(77)
import numpy as np

SOURCE, PLEAT = (Path(argument).resolve() for argument in sys.argv[1:3])


def load(name):
    spec = importlib.util.spec_from_file_location(name, SOURCE / f"deploy/blender/pleat/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


exchange, bridges = load("exchange"), load("bridge")


def read_garment():
    points, uv, faces, uv_faces = [], [], [], []
    for line in (SOURCE / "deploy/garments/tablecloth.obj").read_text().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            points.append([float(word) for word in words])
        elif kind == "vt":
            uv.append([float(word) for word in words[:2]])
        elif kind == "f":
            corners = [word.split("/") for word in words]
            faces.append([int(corner[0]) - 1 for corner in corners])
            uv_faces.append([int(corner[1]) - 1 for corner in corners])
    return np.array(points, np.float32), np.array(faces), np.array(uv, np.float32), np.array(uv_faces)


class Exchange(unittest.TestCase):
    def test_axes_and_units(self):
        # Blender's up becomes Pleat's up, and the handedness stays.
        axes = exchange.to_pleat(np.eye(3), 0.01)
        np.testing.assert_allclose(axes, [[0.01, 0, 0], [0, 0, -0.01], [0, 0.01, 0]])
        self.assertGreater(np.linalg.det(axes), 0)

    def test_maps_are_brought_to_lengths_in_space(self):
        points, faces, uv, uv_faces = read_garment()
        corners = uv[uv_faces]
        for factors in ((1, 1), (3, 3), (0.5, 4)):
            found, error = exchange.fit_scale(points, faces, corners / np.array(factors))
            np.testing.assert_allclose(found, factors, rtol=1e-3)
            self.assertLess(error, 1e-3)
        turned = corners @ np.array([[0.8, 0.6], [-0.6, 0.8]])
        found, error = exchange.fit_scale(points, faces, turned)
        self.assertLess(error, 1e-3)
        np.testing.assert_allclose(found, (1, 1), rtol=1e-3)
        self.assertGreater(exchange.fit_scale(points, faces, corners**2)[1], 0.1)


class Bridge(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.bridge = bridges.Bridge(str(PLEAT))
        cls.bridge.wait("ready")
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = Path(cls.temporary.name)
        cls.points, cls.faces, uv, uv_faces = read_garment()
        exchange.write_obj(cls.folder / "rest.obj", cls.points, cls.faces, uv, uv_faces)
        cls.coarse = exchange.Pc2Writer(cls.folder / "coarse.pc2", len(cls.points))
        for k in range(8):
            frame = cls.points.copy()
            frame[:, 1] += 0.02 * np.sin(6 * frame[:, 0] + 0.3 * k)
            cls.coarse.add(frame)
        cls.coarse.close()

    @classmethod
    def tearDownClass(cls):
        cls.bridge.close()
        cls.temporary.cleanup()

    def open(self, **more):
        self.bridge.send({"open": {"rest": str(self.folder / "rest.obj"), "mesh": str(self.folder / "fine.obj"),
                                   "frame_time_s": 0.04, **more}})
        return self.bridge.wait("opened")

    def enhance(self, fine, first, count, **more):
        self.bridge.send({"enhance": {"coarse": self.coarse.path, "fine": str(self.folder / fine), "first": first,
                                      "count": count, **more}})
        frames = []
        while True:
            answer = self.bridge.poll(60)
            if answer[0] == "enhanced":
                return frames
            frames.append(answer[1])

    def test_frames_in_pieces_are_those_of_one_request(self):
        opened = self.open()
        self.assertEqual((opened["vertices"], opened["rounds"], opened["detail"]), (11393, 2, "fold"))
        points, faces = exchange.read_obj(self.folder / "fine.obj")
        self.assertEqual(len(points), 11393)
        # What the corners of coarse faces have comes to those of the fine ones.
        corners = exchange.to_fine(self.points[self.faces].astype(np.float64), 2)
        np.testing.assert_allclose(points[faces], corners, atol=1e-5)

        frames = self.enhance("whole.pc2", 0, 8)
        self.assertEqual([frame["sample"] for frame in frames], list(range(8)))
        self.assertEqual(sum(frame["self_intersections"] for frame in frames), 0)
        self.enhance("pieces.pc2", 0, 5, restart=True)
        self.enhance("pieces.pc2", 5, 3)
        for k in range(8):
            whole = exchange.read_pc2(self.folder / "whole.pc2", k)
            np.testing.assert_array_equal(exchange.read_pc2(self.folder / "pieces.pc2", k), whole)
        self.assertLess(np.abs(whole[:len(self.points)] - self.points).max(), 0.1)
        # From a sample of the middle on, what follows it is given up.
        self.enhance("pieces.pc2", 2, 1)
        with self.assertRaisesRegex(ValueError, "no sample 3"):
            exchange.read_pc2(self.folder / "pieces.pc2", 3)

    def test_obstacles_move(self):
        sphere = np.array([[0, 0, 0.1], [0.09, 0, -0.05], [-0.045, 0.078, -0.05], [-0.045, -0.078, -0.05]], np.float32)
        faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
        middle = self.points.mean(axis=0)
        exchange.write_obj(self.folder / "body.obj", sphere, faces)
        path = exchange.Pc2Writer(self.folder / "body.pc2", 4)
        for k in range(8):
            # From below through the cloth's height; the tip stays under it until frame 6.
            path.add(exchange.to_pleat(sphere, 1) + middle + np.float32([0, -0.18 + 0.0135 * k, 0]))
        path.close()
        self.open(obstacles=[{"name": "Body", "mesh": str(self.folder / "body.obj"), "moved": True}])
        frames = self.enhance("body-fine.pc2", 0, 8, obstacles={"Body": path.path})
        self.assertEqual(sum(frame["penetrations"] for frame in frames), 0)
        self.open()
        self.enhance("free-fine.pc2", 0, 8)
        apart = [np.abs(exchange.read_pc2(self.folder / "body-fine.pc2", k) -
                        exchange.read_pc2(self.folder / "free-fine.pc2", k)).max() for k in range(8)]
        self.assertLess(apart[0], 1e-3)
        self.assertGreater(apart[7], 5e-3)

    def test_wrong_requests_are_named_and_the_bridge_goes_on(self):
        self.open()
        for request, cause in (({"oben": {}}, "unknown request 'oben'"),
                               ({"open": {"rest": "x.obj", "size": 3}}, "open: unknown key 'size'"),
                               ({"open": {"mesh": "x.obj"}}, "open: rest is missing"),
                               ({"open": {"rest": str(self.folder / "none.obj"), "mesh": "x.obj"}}, "none.obj"),
                               ({"enhance": {}}, "nothing was opened")):
            self.bridge.send(request)
            with self.assertRaisesRegex(bridges.BridgeError, cause):
                self.bridge.wait("opened")
        self.open()
        self.bridge.send({"enhance": {"coarse": 3, "fine": "x.pc2"}})
        with self.assertRaisesRegex(bridges.BridgeError, "coarse: a value of another kind"):
            self.bridge.wait("enhanced")
        precious = self.folder / "precious.pc2"
        precious.write_text("mine")
        self.bridge.send({"enhance": {"coarse": self.coarse.path, "fine": str(precious)}})
        with self.assertRaisesRegex(bridges.BridgeError, "was not made by Pleat"):
            self.bridge.wait("enhanced")
        self.assertEqual(precious.read_text(), "mine")
        self.bridge._process.stdin.write("no json\n")
        self.bridge._process.stdin.flush()
        with self.assertRaisesRegex(bridges.BridgeError, "not JSON"):
            self.bridge.wait("opened")
        self.assertEqual(len(self.enhance("after.pc2", 0, 2)), 2)

    def test_a_cancel_drops_what_was_asked_for(self):
        self.open()
        for fine in ("first.pc2", "second.pc2"):
            self.bridge.send({"enhance": {"coarse": self.coarse.path, "fine": str(self.folder / fine)}})
        self.bridge.wait("frame")
        self.bridge.send({"cancel": True})
        self.assertEqual(self.bridge.wait("cancelled"), {})
        self.assertFalse((self.folder / "second.pc2").exists())
        self.assertEqual(len(self.enhance("third.pc2", 0, 3)), 3)

    def test_lines_from_a_file_are_worked_off_to_their_end(self):
        lines = [{"open": {"rest": str(self.folder / "rest.obj"), "mesh": str(self.folder / "lines.obj")}},
                 {"enhance": {"coarse": self.coarse.path, "fine": str(self.folder / "lines.pc2"), "count": 2}}]
        done = subprocess.run([PLEAT, "bridge"], input="".join(json.dumps(line) + "\n" for line in lines), text=True,
                              capture_output=True, timeout=200)
        self.assertEqual(done.returncode, 0, done.stderr)
        kinds = [next(iter(json.loads(line))) for line in done.stdout.splitlines()]
        self.assertEqual(kinds, ["ready", "opened", "frame", "frame", "enhanced"])


unittest.main(argv=sys.argv[:1])
