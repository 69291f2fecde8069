"""A closed network of queues: frames in flight that visit the stages one after the other.

Mean-value analysis (Reiser and Lavenberg 1980), with Seidmann's station for several servers: c servers of demand D are one of
demand D / c and a delay of D (c - 1) / c. Exact for exponential service times at one server; ours vary less, so the queues in
here are longer than real ones and the throughput a little less near the knee."""

import dataclasses


@dataclasses.dataclass
class Station:
    name: str
    demand_s: float  # of a frame, by one server
    servers: float = 1

    @property
    def capacity(self):
        """Frames per second at most."""
        return self.servers / self.demand_s


def solve(stations, customers, think_s=0.0):
    """(frames per second, seconds from entering to leaving) with so many frames in the network. O(customers stations)."""
    queues = [0.0] * len(stations)
    throughput, response = 0.0, 0.0
    for n in range(1, customers + 1):
        residence = [s.demand_s / s.servers * (1 + q) for s, q in zip(stations, queues)]
        delay = sum(s.demand_s * (s.servers - 1) / s.servers for s in stations if s.servers > 1)
        response = sum(residence) + delay
        throughput = n / (think_s + response)
        queues = [throughput * r for r in residence]
    return throughput, response


def bottleneck(stations):
    return min(stations, key=lambda station: station.capacity)


def replicas_for(demand_s, rate, most_busy=0.8):
    """Servers that are busy at most this share of the time."""
    return max(1, -(-rate * demand_s // most_busy))
