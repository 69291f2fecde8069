#!/usr/bin/env python3
"""The queueing model against closed forms, and one short point of serving: BUILD. No figure is judged here."""

import pathlib
import sys
import unittest

sys.path[:0] = [str(pathlib.Path(__file__).resolve().parent), str(pathlib.Path(__file__).resolve().parents[2] / "integration")]
import queueing  # noqa: E402
import serving  # noqa: E402
import shares  # noqa: E402
from queueing import Station  # noqa: E402


class Queueing(unittest.TestCase):
    def test_one_station_is_always_full(self):
        throughput, response = queueing.solve([Station("a", 0.02)], 7)
        self.assertAlmostEqual(throughput, 50)
        self.assertAlmostEqual(response, 7 * 0.02)

    def test_balanced_stations(self):
        # n customers at m equal queues: n / (D (n + m - 1)) (Lazowska et al. 1984, 5.2).
        for m in (2, 5):
            for n in (1, 3, 20):
                throughput, _ = queueing.solve([Station(str(k), 0.01) for k in range(m)], n)
                self.assertAlmostEqual(throughput, n / (0.01 * (n + m - 1)))

    def test_thinking_customers_hardly_meet(self):
        throughput, response = queueing.solve([Station("a", 1e-3)], 10, think_s=10)
        self.assertAlmostEqual(throughput, 10 / (10 + response))
        self.assertLess(response, 1.002e-3)

    def test_many_customers_fill_the_slowest(self):
        stations = [Station("a", 0.01, 2), Station("b", 0.03, 4), Station("c", 0.001)]
        self.assertEqual(queueing.bottleneck(stations).name, "b")
        self.assertAlmostEqual(queueing.solve(stations, 3000)[0], 4 / 0.03, delta=0.5)

    def test_replicas(self):
        self.assertEqual(queueing.replicas_for(0.01, 80), 1)
        self.assertEqual(queueing.replicas_for(0.01, 81), 2)
        self.assertEqual(queueing.replicas_for(0.01, 0), 1)


class Serving(unittest.TestCase):
    def test_a_point(self):
        for stage in ("superres", "simulation"):
            try:
                point = serving.measure(BUILD / "bin", stage, 2, 0.2, 1, 2)
            except shares.Unavailable as reason:
                self.skipTest(str(reason))
            self.assertGreater(point["frames_per_s"], 0)
            self.assertGreater(point["cpu_ms"][stage], 0)


BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
unittest.main(verbosity=2)
