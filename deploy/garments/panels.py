"""Two panels, front and back, sewn along their outline around a body: T-shirts and trousers.

A panel is a triangulated region of the plane (x, y), raised in front of (or behind) the body as a height field z.
"""
import numpy as np


def spread(line, count):
    """`count` edges of equal length along a polyline, both ends included."""
    line = np.array(line, float)
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0], np.cumsum(steps)])
    wanted = np.linspace(0, along[-1], count + 1)
    return np.column_stack([np.interp(wanted, along, line[:, k]) for k in range(2)])


def inside(points, polygon):
    x, y = points[:, 0, None], points[:, 1, None]
    a, b = polygon, np.roll(polygon, -1, axis=0)
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return ((crosses & (x < at)).sum(axis=1) % 2).astype(bool)


def distance_to(points, polygon):
    a, b = polygon, np.roll(polygon, -1, axis=0)
    along = b - a
    t = (((points[:, None] - a) * along).sum(axis=2) / (along**2).sum(axis=1)).clip(0, 1)
    return np.linalg.norm(points[:, None] - (a + t[..., None] * along), axis=2).min(axis=1)


def delaunay(points):
    """Triangles (counter-clockwise) of the Delaunay triangulation (Bowyer and Watson)."""
    middle, size = points.mean(axis=0), 50 * np.ptp(points, axis=0).max()
    corners = middle + size * np.array([[-1.7, -1], [1.7, -1], [0, 2]])
    all_points = np.vstack([points, corners])
    n = len(points)

    def circle(triangle):
        a, b, c = all_points[list(triangle)]
        matrix = 2 * np.array([b - a, c - a])
        centre = np.linalg.solve(matrix, np.array([b @ b - a @ a, c @ c - a @ a]))
        return centre, ((a - centre) ** 2).sum()

    triangles = {(n, n + 1, n + 2): circle((n, n + 1, n + 2))}
    for p in range(n):
        bad = [t for t, (centre, square) in triangles.items() if ((all_points[p] - centre) ** 2).sum() < square]
        edges = {}
        for t in bad:
            for k in range(3):
                edge = (t[k], t[(k + 1) % 3])
                if edges.pop(edge[::-1], None) is None:
                    edges[edge] = True
            del triangles[t]
        for a, b in edges:
            triangles[(a, b, p)] = circle((a, b, p))
    return np.array([t for t in triangles if max(t) < n])


def triangulate(outline, interior, seed):
    """Points (the outline's first, counter-clockwise) and triangles of the region, with exactly `interior` points in it."""
    random = np.random.default_rng(seed)
    low, high = outline.min(axis=0), outline.max(axis=0)
    candidates = low + random.random((6000, 2)) * (high - low)
    candidates = candidates[inside(candidates, outline)]
    spacing = 0.35 * np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).mean()
    candidates = candidates[distance_to(candidates, outline) > spacing]
    chosen = outline.copy()
    for _ in range(interior):  # the farthest candidate from all that were chosen
        gaps = np.linalg.norm(candidates[:, None] - chosen[None], axis=2).min(axis=1)
        chosen = np.vstack([chosen, candidates[gaps.argmax()]])
    for _ in range(40):  # Laplacian smoothing of the interior
        faces = region(chosen, outline)
        total, times = np.zeros_like(chosen), np.zeros(len(chosen))
        for k in range(3):
            for other in (1, 2):
                np.add.at(total, faces[:, k], chosen[faces[:, (k + other) % 3]])
                np.add.at(times, faces[:, k], 1)
        moved = total / times[:, None]
        step = np.abs(moved - chosen)[len(outline) :].max()
        chosen[len(outline) :] = moved[len(outline) :]
        if step < 1e-4:
            break
    return chosen, region(chosen, outline)


def region(points, outline):
    faces = delaunay(points)
    faces = faces[inside(points[faces].mean(axis=1), outline)]
    assert len(faces) == 2 * len(points) - 2 - len(outline), "the outline is not among the edges of the triangles"
    return faces


def without_shortcuts(points, faces, seams):
    """The faces with edges flipped that join two points of the seams inside: sewn panels would share them."""
    faces = [list(face) for face in faces]
    outline = {frozenset((a, b)) for seam in seams for a, b in zip(seam, seam[1:])}
    on_seam = {vertex for seam in seams for vertex in seam}
    while True:
        owners = {}
        for f, face in enumerate(faces):
            for k in range(3):
                owners.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append((f, k))
        bad = [edge for edge, two in owners.items() if edge <= on_seam and edge not in outline and len(two) == 2]
        if not bad:
            return np.array(faces)
        (f, k), (g, m) = owners[bad[0]]
        a, b, c = faces[f][k], faces[f][(k + 1) % 3], faces[f][(k + 2) % 3]
        d = faces[g][(m + 2) % 3]
        assert not {c, d} <= on_seam, "an edge between seams can't be flipped away"
        faces[f], faces[g] = [c, a, d], [c, d, b]


def raise_over(points, faces, fixed, body_vertices, clearance, rounds=400):
    """Heights of the points, at least `clearance` over every body vertex that lies under a triangle; `fixed` ones given."""
    heights = np.where(np.isnan(fixed), np.nanmean(fixed), fixed)
    movable = np.isnan(fixed)
    owner, weights = locate(points, faces, body_vertices[:, :2])
    found = owner >= 0
    corners, weights, wanted = faces[owner[found]], weights[found], body_vertices[found, 2] + clearance
    neighbours = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    for round_ in range(rounds):
        if round_ < rounds // 2:  # smooth first, then only lift
            total, times = np.zeros(len(points)), np.zeros(len(points))
            for a, b in (neighbours.T, neighbours[:, ::-1].T):
                np.add.at(total, a, heights[b])
                np.add.at(times, a, 1)
            heights = np.where(movable, heights + 0.5 * (total / times - heights), heights)
        lack = wanted - (weights * heights[corners]).sum(axis=1)
        free = weights * movable[corners]
        norm = (free**2).sum(axis=1)
        push = np.where((lack > 0) & (norm > 1e-4), lack / norm.clip(1e-4), 0)[:, None] * free
        lifts = np.zeros(len(points))
        np.maximum.at(lifts, corners.reshape(-1), push.reshape(-1))
        heights = heights + lifts
    return heights


def locate(points, faces, queries):
    """The triangle that holds each query, -1 if none does, and barycentric weights."""
    owner, weights = np.full(len(queries), -1), np.zeros((len(queries), 3))
    for f, (i, j, k) in enumerate(faces):
        a, e1, e2 = points[i], points[j] - points[i], points[k] - points[i]
        determinant = e1[0] * e2[1] - e1[1] * e2[0]
        p = queries - a
        v = (p[:, 0] * e2[1] - p[:, 1] * e2[0]) / determinant
        w = (e1[0] * p[:, 1] - e1[1] * p[:, 0]) / determinant
        here = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1 + 1e-9)
        owner[here] = f
        weights[here] = np.column_stack([1 - v - w, v, w])[here]
    return owner, weights


def flattened(vertices, faces, start, rounds=60):
    """Places in the plane for a disc in space, as rigid as possible by triangle (Liu et al. 2008, local and global)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    along = b - a
    length = np.linalg.norm(along, axis=1)
    across = ((c - a) * along).sum(axis=1) / length
    height = np.linalg.norm(np.cross(along, c - a), axis=1) / length
    zero = np.zeros(len(faces))
    own = np.stack([np.column_stack([zero, zero]), np.column_stack([length, zero]), np.column_stack([across, height])], 1)
    sides = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]  # an edge and the corner opposite, whose cotangent is its weight
    weights = []
    for i, j, k in sides:
        u, v = own[:, i] - own[:, k], own[:, j] - own[:, k]
        weights.append(((u * v).sum(axis=1) / np.cross(u, v)).clip(0.05))
    matrix = np.zeros((len(vertices), len(vertices)))
    for (i, j, _), weight in zip(sides, weights):
        for row, column, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            np.add.at(matrix, (faces[:, row], faces[:, column]), sign * weight)
    matrix[0, 0] += 1  # holds the first point
    flat = start.copy()
    for _ in range(rounds):
        sums = np.zeros((len(faces), 2, 2))
        for (i, j, _), weight in zip(sides, weights):
            now, mine = flat[faces[:, j]] - flat[faces[:, i]], own[:, j] - own[:, i]
            sums += weight[:, None, None] * np.einsum("fi,fj->fij", now, mine)
        angle = np.arctan2(sums[:, 1, 0] - sums[:, 0, 1], sums[:, 0, 0] + sums[:, 1, 1])
        turn = np.stack([np.stack([np.cos(angle), -np.sin(angle)], 1), np.stack([np.sin(angle), np.cos(angle)], 1)], 1)
        right = np.zeros_like(flat)
        for (i, j, _), weight in zip(sides, weights):
            wanted = weight[:, None] * np.einsum("fij,fj->fi", turn, own[:, j] - own[:, i])
            np.add.at(right, faces[:, j], wanted)
            np.add.at(right, faces[:, i], -wanted)
        right[0] += start[0]
        flat = np.linalg.solve(matrix, right)
    return flat


def sew(body, outline, heights, interiors, clearance, seed):
    """Both panels as one mesh: vertices, faces (outwards), flat places and their faces.

    `outline` is counter-clockwise and holds the pieces in order, ((x, y) points, edges, is_opening); `heights(point)` is
    z of the seams; `interiors` are the numbers of inner points, front and back. Openings lie on the panels.
    """
    corners, seams = [], []
    for line, count, is_opening in outline:
        first = len(corners)
        corners += list(spread(line, count)[:-1])
        if not is_opening:
            seams.append(list(range(first, first + count + 1)))
    total = len(corners)
    seams = [[v % total for v in seam] for seam in seams]
    on_seam = np.zeros(total, bool)
    on_seam[[v for seam in seams for v in seam]] = True
    outline_points = np.array(corners)
    vertices, faces, flat, flat_faces = [], [], [], []
    shared = {}
    for side, interior in zip((1, -1), interiors):
        points, triangles = triangulate(outline_points, interior, seed + side)
        triangles = without_shortcuts(points, triangles, seams)
        fixed = np.full(len(points), np.nan)
        fixed[:total][on_seam] = [side * heights(p) for p in outline_points[on_seam]]
        mirrored = body.vertices * [1, 1, side]
        z = side * raise_over(points, triangles, fixed, mirrored, clearance)
        placed = np.column_stack([points, z])
        index = []
        for v, place in enumerate(placed):
            if v < total and on_seam[v]:
                if v not in shared:
                    shared[v] = len(vertices)
                    vertices.append(place)
                index.append(shared[v])
            else:
                index.append(len(vertices))
                vertices.append(place)
        lying = flattened(placed, triangles, points)
        if side < 0:  # seen from behind
            triangles, lying = triangles[:, ::-1], lying * [-1, 1]
        offset = 0 if side > 0 else np.max(flat, axis=0)[0] - lying[:, 0].min() + 0.05
        flat_faces += list(triangles + len(flat))
        flat += list(lying + [offset, 0])
        faces += list(np.array(index)[triangles])
    return np.array(vertices), np.array(faces), np.array(flat), np.array(flat_faces)
