#!/usr/bin/env python3
"""The package `pleat` out of its wheel against services of its own: SOURCE PLEAT. Exit code 77: packages are missing."""

import importlib.util
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

missing = [name for name in ("grpc", "h5py", "numpy", "setuptools", "wheel") if not importlib.util.find_spec(name)]
missing += [name for name in ("protoc", "grpc_python_plugin") if not shutil.which(name)]
if missing:
    print("skipped: no " + ", ".join(missing))
    sys.exit(77)

SOURCE, PLEAT = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
FOLDER = tempfile.TemporaryDirectory()
subprocess.run([SOURCE / "common/client/python/build.sh", FOLDER.name], check=True, stdout=subprocess.DEVNULL)
assert list(pathlib.Path(FOLDER.name, "dist").glob("pleat-*.tar.gz")), "no sdist"
sys.path.insert(0, str(next(pathlib.Path(FOLDER.name, "dist").glob("pleat-*.whl"))))
os.environ["PLEAT_PROGRAM"] = str(PLEAT)
os.environ.pop("PLEAT_COORDINATOR", None)

import numpy as np  # noqa: E402

import pleat  # noqa: E402
from pleat.v1 import coordinator_pb2  # noqa: E402

GARMENT = pleat.read_obj(SOURCE / "deploy/garments/tablecloth.obj")


def waves(count):
    for k in range(count):
        frame = GARMENT.positions.copy()
        frame[:, 1] += 0.02 * np.sin(6 * frame[:, 0] + 0.16 * k)
        yield frame


class Package(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.client = pleat.connect()

    @classmethod
    def tearDownClass(cls):
        cls.client.close()

    def test_the_version_is_the_projects(self):
        self.assertIn(f"project(pleat VERSION {pleat.__version__} ", (SOURCE / "CMakeLists.txt").read_text())

    def test_frames_come_back_in_order_and_clean(self):
        with self.client.session(GARMENT, model="draping") as session:
            self.assertEqual(session.fine.positions.shape, (11393, 3))
            frames = list(session.enhance(waves(6)))
            self.assertEqual([frame.index for frame in frames], list(range(6)))
            for frame, coarse in zip(frames, waves(6)):
                self.assertEqual(frame.positions.shape, (11393, 3))
                self.assertEqual(frame.report.self_intersections_after, 0)
                self.assertLess(np.abs(frame.positions[session.feature_vertices] - coarse).max(), 0.05)
                self.assertIn("superres", frame.stage_ms)
            # A second call goes on.
            self.assertEqual(session.enhance_all(waves(2)).shape, (2, 11393, 3))

    def test_a_session_outlives_its_coordinator(self):
        with self.client.session(GARMENT, detail="fold") as session:
            undisturbed = session.enhance_all(waves(40))
        with self.client.session(GARMENT, detail="fold") as session:
            frames = []
            for frame in session.enhance(waves(40)):
                frames.append(frame.positions)
                if frame.index in (10, 33):
                    subprocess.run(["pkill", "-KILL", "-P", str(self.client._services._process.pid), "-f", "pleat-coordinator"],
                                   check=True)
        np.testing.assert_array_equal(np.stack(frames), undisturbed)

    def test_a_session_belongs_to_the_trace_that_is_given(self):
        trace = "4bf92f3577b34da6a3ce929d0e0e4736"
        with pleat.connect(self.client.address, traceparent=f"00-{trace}-00f067aa0ba902b7-01") as client:
            with client.session(GARMENT, detail="fold"):
                request = coordinator_pb2.ListJobsRequest(live_sessions=True)
                jobs = client._stub.ListJobs(request, timeout=30).jobs
                self.assertIn(trace, [job.trace_id for job in jobs])

    def test_frames_are_read_as_the_window_allows(self):
        read = []

        def source():
            for k, frame in enumerate(waves(8)):
                read.append(k)
                yield frame

        with self.client.session(GARMENT, model="draping", window=2) as session:
            for frame in session.enhance(source()):
                self.assertLessEqual(len(read), frame.index + 2)

    def test_the_fold_step_needs_no_bundle(self):
        with self.client.session(GARMENT, detail="fold") as session:
            frames = list(session.enhance(waves(2)))
        self.assertIn("fold", frames[1].stage_ms)
        self.assertNotIn("superres", frames[1].stage_ms)
        with self.client.session(GARMENT, detail="fold", material=SOURCE / "deploy/materials/felt.json") as session:
            felt = list(session.enhance(waves(2)))
        self.assertGreater(np.abs(felt[1].positions - frames[1].positions).max(), 1e-5)
        with self.assertRaisesRegex(pleat.PleatError, "749"):
            self.client.session(GARMENT, detail="fold", held=[749])
        with self.assertRaisesRegex(ValueError, "network, fold, both and none"):
            self.client.session(GARMENT, detail="folds")

    def test_obstacles_keep_the_cloth_out(self):
        center = [0.0, -0.095, 0.0]
        ball = pleat.sphere("ball", center, 0.1)
        with self.client.session(GARMENT, model="draping", obstacles=[ball]) as session:
            flat = GARMENT.positions - [0, GARMENT.positions[:, 1].mean(), 0]
            fine = session.enhance_all([flat.astype(np.float32)])[0]
        self.assertGreater(np.linalg.norm(fine - np.float32(center), axis=1).min(), 0.0999)

    def test_wrong_input_is_an_error_with_a_code(self):
        with self.assertRaisesRegex(pleat.PleatError, "nobody") as caught:
            self.client.session(GARMENT, model="nobody")
        self.assertEqual(caught.exception.code, "NOT_FOUND")
        with self.client.session(GARMENT, model="draping") as session:
            with self.assertRaisesRegex(ValueError, r"shape \(3, 3\)"):
                next(session.enhance([np.zeros((3, 3))]))
            with self.assertRaises(pleat.PleatError):
                next(session.enhance([np.full_like(GARMENT.positions, np.nan)]))
        with self.assertRaisesRegex(ValueError, "names 9 of 3"):
            pleat.Mesh(np.zeros((3, 3)), np.array([[0, 1, 9]]))
        with self.assertRaises(pleat.PleatError) as caught:
            pleat.connect("unix:/nowhere/at/all.sock", timeout_s=1)
        self.assertEqual(caught.exception.code, "UNAVAILABLE")

    def test_scenes_give_results_and_jobs(self):
        with self.client.run(SOURCE / "deploy/scenes/draping.json", FOLDER.name + "/run", model="draping", frames=3) as result:
            self.assertEqual(len(result), 3)
            self.assertEqual(result.enhanced[0].shape, (11393, 3))
            self.assertEqual(result.mesh("coarse").positions.shape, (749, 3))
            self.assertEqual(result.count("self_intersections").sum(), 0)
            self.assertEqual(result.stage_ms("superres").shape, (3,))
            np.testing.assert_allclose(np.diff(result.times), 0.04)
        job = self.client.jobs()[0]
        self.assertEqual((job.state, job.frames_complete), ("done", 3))
        self.assertEqual(self.client.job(job.id).scene, job.scene)
        self.assertEqual(list(self.client.watch(job.id))[-1], job)
        with self.assertRaisesRegex(pleat.PleatError, "nobody"):
            list(self.client.watch("nobody"))
        self.assertEqual(self.client.remove_job(job.id).owner, "local")
        with self.assertRaisesRegex(pleat.PleatError, "NOT_FOUND"):
            self.client.job(job.id)
        with self.assertRaisesRegex(pleat.PleatError, "no-scene.json"):
            self.client.run("no-scene.json")

    def test_data_sets_are_arrays(self):
        folder = FOLDER.name + "/set"
        subprocess.run([PLEAT, "dataset", "generate", folder, "--set", "hitting", "--train", "1", "--test", "0", "--frames",
                        "2", "--workers", "1"], check=True, capture_output=True)
        dataset = pleat.Dataset(folder)
        self.assertEqual(dataset.names, ["hitting-00"])
        with dataset["hitting-00"] as sequence:
            self.assertEqual(sequence.split, "train")
            self.assertEqual(sequence.coarse[0].shape, dataset.coarse.positions.shape)
            self.assertEqual(sequence.fine[:].shape, (2, *dataset.fine.positions.shape))


unittest.main(argv=sys.argv[:1])
