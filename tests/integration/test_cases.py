#!/usr/bin/env python3
"""Files that people really have (tests/cases), from the command line to the frames that come out: SOURCE PLEAT TRAIN. Exit
code 77: h5py or numpy is missing. What the readers alone decide has unit tests beside each reader."""

import json
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest

try:
    import h5py
    import numpy as np
except ImportError as missing:
    print(f"skipped: {missing} (Debian: python3-h5py python3-numpy)")
    sys.exit(77)

SOURCE, PLEAT, TRAIN = (pathlib.Path(argument).resolve() for argument in sys.argv[1:4])
CASES = SOURCE / "tests/cases"


class Cases(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.temporary.cleanup)
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.models = cls.folder / "models"
        cls.models.mkdir()
        up = subprocess.Popen([PLEAT, "up", "--data", cls.folder / "data", "--models", cls.models], stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, text=True)
        cls.addClassCleanup(up.stdout.close)
        cls.addClassCleanup(up.wait)
        cls.addClassCleanup(up.send_signal, signal.SIGINT)
        cls.coordinator = next(line.split()[1] for line in up.stdout if line.startswith("ready "))

    def pleat(self, *words, code=0, program=PLEAT):
        done = subprocess.run([str(word) for word in (program, *words)], cwd=SOURCE, capture_output=True, text=True,
                              timeout=300)
        self.assertEqual(done.returncode, code, done.stdout[-2000:] + done.stderr[-2000:])
        return done

    def frames(self, command, *words, code=0):
        """Coarse and enhanced positions of a run."""
        out = self.folder / f"out-{self.id()}-{len(list(self.folder.iterdir()))}"
        self.pleat(command, *words, "--out", out, "--coordinator", self.coordinator, "-q", code=code)
        with h5py.File(out / "result.h5") as result:
            return result["coarse/positions"][:], result["enhanced/positions"][:]

    def run_scene(self, scene, *words):
        return self.frames("run", CASES / scene, *words)

    def test_a_concave_polygon_covers_its_own_area(self):
        triangles = self.run_scene("05-obj-concave-polygon/table-triangles.json")[0]
        # It falls freely, beside any surface.
        self.assertAlmostEqual(float(triangles[9][:, 1].mean()), -0.314, delta=0.002)
        for table in ("table-polygon", "table-closing-vertex"):
            other = self.run_scene(f"05-obj-concave-polygon/{table}.json")[0]
            np.testing.assert_allclose(other[9], triangles[9], atol=1e-3)

    def test_an_obstacle_needs_no_material_coordinates(self):
        coarse = self.run_scene("06-obj-some-objects-without-uv/scene.json")[0]
        self.assertTrue(np.isfinite(coarse).all())

    def test_another_unit_and_another_order_are_refused(self):
        case = CASES / "11-garment-centimetres"
        done = self.pleat("run", case / "skirt-mm-uv-m.json", "--out", self.folder / "mm", "--coordinator", self.coordinator,
                          code=2)
        self.assertRegex(done.stderr, "as long in space")
        case = CASES / "14-pc2-other-vertex-order"
        words = ["enhance", "--rest", case / "garment.obj", "--out", self.folder / "order", "--coordinator", self.coordinator]
        done = self.pleat(*words, "--frames", case / "shuffled.pc2", code=2)
        self.assertRegex(done.stderr, "order")
        self.pleat(*words, "--frames", case / "right.pc2")

    def test_open_bodies_are_obstacles(self):
        closed = self.run_scene("18-body-mesh-with-holes/closed.json")[0]
        for body in ("small-hole", "inside-out", "open-neck"):
            other = self.run_scene(f"18-body-mesh-with-holes/{body}.json")[0]
            apart = np.linalg.norm(other - closed, axis=2).max()
            self.assertLess(apart, 1e-3 if body != "open-neck" else 0.02, body)
        self.run_scene("18-body-mesh-with-holes/ground-quad.json")

    def test_cloth_on_a_surface_does_not_jump(self):
        touching = CASES / "20-cloth-exactly-on-surface/touching.json"
        done = self.pleat("run", touching, "--out", self.folder / "touching", "--coordinator", self.coordinator, code=2)
        self.assertRegex(done.stderr, "the cloth touches obstacle 'table'")
        for scene in ("touching", "touching-perturbed", "tenth-of-millimetre"):
            coarse, fine = self.run_scene(f"20-cloth-exactly-on-surface/{scene}.json", "--untangle")
            for frames in (coarse, fine):
                heights = frames[:, :, 1].mean(axis=1)
                self.assertLess(np.abs(np.diff(heights)).max(), 1.5e-3, (scene, heights))

    def test_of_a_long_motion_only_what_is_needed_is_read(self):
        case = CASES / "31-long-motion-of-a-body"
        scene = json.loads((case / "scene.json").read_text())
        subprocess.run(["/usr/bin/python3", case / "make.py", "800", self.folder / "body.pc2"], check=True, cwd=self.folder)
        for key in ("garmentFile", "materialFile"):
            scene[key] = str(case / scene[key])
        (self.folder / "scene.json").write_text(json.dumps(scene))
        coarse = self.frames("run", self.folder / "scene.json", "--frames", "12")[0]
        self.assertEqual(len(coarse), 12)

    def data_set(self, garment, *words):
        name = self.folder / f"set-{pathlib.Path(garment).stem}-{len(list(self.folder.iterdir()))}"
        self.pleat("dataset", "generate", name, "--garment", garment, "--train", 1, "--test", 1, "--frames", 6, "--workers", 1,
                   *words)
        return name

    def train(self, name, data, config=SOURCE / "deploy/models/own-garment.train.json"):
        """A few steps of what is shipped for a garment of one's own, with a small network; the bundle's path."""
        wanted = json.loads(pathlib.Path(config).read_text())
        wanted.update(name=name, dataset=str(data), output=str(self.folder / f"train-{name}"), epochs=1, steps_per_epoch=2)
        wanted["architecture"].update(blocks=1, layers=2, growth=8, features=8)
        wanted["schedule"]["warm_up_steps"] = 1
        path = self.folder / f"{name}.train.json"
        path.write_text(json.dumps(wanted))
        self.pleat(path, program=TRAIN)
        return self.folder / f"train-{name}/{name}.pt"

    def test_the_walk_with_a_garment_of_ones_own(self):
        garment = CASES / "12-own-garment-walkthrough/skirt.obj"
        bundle = self.train("mine", self.data_set(garment, "--set", "draping"))
        (self.models / "mine.pt").write_bytes(bundle.read_bytes())
        frames = self.folder / "skirt.npy"
        rest = np.array([[float(word) for word in line.split()[1:4]] for line in garment.read_text().splitlines()
                         if line.startswith("v ")], np.float32)
        np.save(frames, np.stack([rest + np.float32([0, 0.01 * k, 0]) for k in range(4)]))
        as_trained = self.frames("enhance", "--rest", garment, "--frames", frames, "--model", "mine")[1]
        # The same garment, moved and turned: the same frames come out.
        turn = np.array([[0, 0.6, 0.8], [1, 0, 0], [0, 0.8, -0.6]])
        moved = rest @ turn.T + [0.5, -2, 1]
        lines, k = [], 0
        for line in garment.read_text().splitlines():
            if line.startswith("v "):
                line, k = "v " + " ".join(f"{value:.7f}" for value in moved[k]), k + 1
            lines.append(line)
        (self.folder / "moved.obj").write_text("\n".join(lines) + "\n")
        again = self.frames("enhance", "--rest", self.folder / "moved.obj", "--frames", frames, "--model", "mine")[1]
        np.testing.assert_allclose(again, as_trained, atol=2e-5)
        # Another shape is another garment.
        lines[next(i for i, line in enumerate(lines) if line.startswith("v "))] = "v 0.5 -2 1"
        (self.folder / "other.obj").write_text("\n".join(lines) + "\n")
        done = self.pleat("enhance", "--rest", self.folder / "other.obj", "--frames", frames, "--model", "mine", "--out",
                          self.folder / "refused", "--coordinator", self.coordinator, code=2)
        self.assertRegex(done.stderr, "mine was trained for another mesh")

    def test_atlases_of_real_garments_train(self):
        for case in ("08-garment-uv-islands-overlap/skirt.obj", "09-garment-mirrored-panel/skirt.obj",
                     "25-shirt-with-button/shirt-button.obj", "32-gap-between-uv-panels/skirt-panels-20cm-apart.obj"):
            with self.subTest(case):
                self.train(case[:2] + "-net", self.data_set(CASES / case, "--set", "hitting"))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[4:], verbosity=2)
