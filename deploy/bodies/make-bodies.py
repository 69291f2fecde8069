#!/usr/bin/python3
"""Makes the bodies of this folder from MakeHuman's base mesh, and the motions from CMU's.

  make-bodies.py MAKEHUMAN CMU [FOLDER]

MAKEHUMAN holds base/base.obj, targets/*.target, rigs/rig.cmu_mb.json and rigs/weights.cmu_mb.json as MakeHuman and
MPFB publish them (CC0); CMU holds the captures that MOTIONS names. README.md says where they come from. A body is the
group `body` of the base (13,380 vertices) with two targets, in metres, standing on y = 0, brought into a T pose by
linear blend skinning; joints have the axes of the world at rest.
"""
import json
import struct
import sys
from pathlib import Path

import numpy as np

BODY_VERTICES = 13380
INFLUENCES = 4
CLAVICLE_DEGREES = 12  # what a shoulder rises when the arm goes up to the horizontal
MOTIONS = {"lambada": "lambada", "pirouette": "pirouette", "charleston": "charleston1"}
# Captures of subject 5 that are at hand on Reallusion's skeleton only, 60 frames a second.
RETARGETED = {f"05_0{take}": f"005_0{take}" for take in range(1, 9)}
# What follows CC_Base_, or CC_Base_L_ and CC_Base_R_, in the joints that a body here has too.
KEPT_JOINTS = {"Hip", "Pelvis", "Waist", "Spine01", "Spine02", "NeckTwist01", "NeckTwist02", "Head", "Clavicle",
               "Upperarm", "Forearm", "Hand", "Thigh", "Calf", "Foot", "ToeBase"}
BODIES = {
    "young-female": ["caucasian-female-young", "universal-female-young-averagemuscle-averageweight"],
    "young-male": ["caucasian-male-young", "universal-male-young-averagemuscle-averageweight"],
}


def read_base(path):
    """All vertices (decimetres), the triangles of the group `body`, and the vertices of every joint cube."""
    vertices, triangles, cubes, group = [], [], {}, ""
    for line in path.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append([float(word) for word in words[1:4]])
        elif words[0] == "g":
            group = words[1]
        elif words[0] == "f":
            corners = [int(word.split("/")[0]) - 1 for word in words[1:]]
            if group == "body":
                triangles += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
            elif group.startswith("joint-"):
                cubes.setdefault(group, set()).update(corners)
    return np.array(vertices), np.array(triangles), cubes


def apply_target(vertices, path):
    for line in path.read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            index, *offset = line.split()
            vertices[int(index)] += [float(value) for value in offset]


def read_joints(folder, vertices, cubes):
    """Names with parents before children, index of the parent, and the place of each joint."""
    rig = json.loads((folder / "rigs/rig.cmu_mb.json").read_text())

    def place(name, end):
        info = rig[name][end]
        if info["strategy"] == "CUBE":
            return vertices[sorted(cubes[info["cube_name"]])].mean(axis=0)
        return vertices[info["vertex_indices"]].mean(axis=0)

    names = []

    def visit(name):
        names.append(name)
        for child in sorted(rig):
            if rig[child]["parent"] == name:
                visit(child)

    visit("Hips")
    parents = [names.index(rig[name]["parent"]) if rig[name]["parent"] else -1 for name in names]
    return names, parents, np.array([place(name, "head") for name in names])


def read_weights(folder, names):
    """The four strongest joints of each vertex, and their weights, which sum to one."""
    table = json.loads((folder / "rigs/weights.cmu_mb.json").read_text())["weights"]
    dense = np.zeros((BODY_VERTICES, len(names)))
    for joint, name in enumerate(names):
        for vertex, weight in table[name]:
            if vertex < BODY_VERTICES:
                dense[vertex, joint] = weight
    joints = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(dense, joints, axis=1)
    return joints, weights / weights.sum(axis=1, keepdims=True)


def rotation_between(a, b):
    """The smallest rotation that turns a's direction into b's."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis, cosine = np.cross(a, b), float(a @ b)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + k + k @ k / (1 + cosine)


def about_z(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def t_pose(names, parents, places):
    """Rotation (world) and new place of every joint with both arms along x."""
    rotations, moved = [np.eye(3)] * len(names), places.copy()
    for joint, name in enumerate(names):
        parent = parents[joint]
        if parent >= 0:
            rotations[joint] = rotations[parent]
            moved[joint] = moved[parent] + rotations[parent] @ (places[joint] - places[parent])
        side = 1.0 if name.startswith("Left") else -1.0
        ends = {"Arm": "ForeArm", "ForeArm": "Hand"}
        part = name.removeprefix("Left").removeprefix("Right")
        if part == "Shoulder":
            rotations[joint] = about_z(side * CLAVICLE_DEGREES)
        elif part in ends:
            end = names.index(name[: -len(part)] + ends[part])
            along = rotations[joint] @ (places[end] - places[joint])
            rotations[joint] = rotation_between(along, np.array([side, 0.0, 0.0])) @ rotations[joint]
    return rotations, moved


def skin(vertices, joints, weights, rotations, places, moved):
    result = np.zeros_like(vertices)
    for k in range(INFLUENCES):
        turn = np.array(rotations)[joints[:, k]]
        local = vertices - places[joints[:, k]]
        result += weights[:, k, None] * (np.einsum("vij,vj->vi", turn, local) + moved[joints[:, k]])
    return result


def write_glb(path, name, vertices, triangles, joints, weights, names, parents, places):
    """One skinned mesh without material, little-endian; joint nodes come first, the mesh node last."""
    bind = np.tile(np.eye(4, dtype=np.float32), (len(names), 1, 1))
    bind[:, 3, :3] = -places
    arrays = [
        (vertices.astype("<f4"), 5126, "VEC3", 34962),
        (joints.astype("<u1"), 5121, "VEC4", 34962),
        (weights.astype("<f4"), 5126, "VEC4", 34962),
        (triangles.astype("<u2").reshape(-1), 5123, "SCALAR", 34963),
        (bind.astype("<f4"), 5126, "MAT4", None),
    ]
    views, accessors, blob = [], [], b""
    for values, component, kind, target in arrays:
        data = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data), **({"target": target} if target else {})})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind})
        blob += data + b"\0" * (-len(data) % 4)
    accessors[0].update(min=vertices.astype("<f4").min(axis=0).tolist(), max=vertices.astype("<f4").max(axis=0).tolist())
    nodes = []
    for joint, joint_name in enumerate(names):
        offset = places[joint] - (places[parents[joint]] if parents[joint] >= 0 else 0)
        children = [child for child, parent in enumerate(parents) if parent == joint]
        nodes.append({"name": joint_name, "translation": offset.round(6).tolist(), **({"children": children} if children else {})})
    nodes.append({"name": name, "mesh": 0, "skin": 0})
    description = {
        "asset": {"version": "2.0", "generator": "deploy/bodies/make-bodies.py",
                  "copyright": "CC0 1.0, from MakeHuman's base mesh hm08"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(nodes) - 1]}],
        "nodes": nodes,
        "meshes": [{"name": name, "primitives": [
            {"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3}]}],
        "skins": [{"joints": list(range(len(names))), "skeleton": 0, "inverseBindMatrices": 4}],
        "bufferViews": views,
        "accessors": accessors,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(description, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(blob), b"BIN\0") + blob)


def make_body(name, targets, makehuman, out):
    vertices, triangles, cubes = read_base(makehuman / "base/base.obj")
    for target in targets:
        apply_target(vertices, makehuman / f"targets/{target}.target")
    vertices *= 0.1
    names, parents, places = read_joints(makehuman, vertices, cubes)
    body = vertices[:BODY_VERTICES]
    joints, weights = read_weights(makehuman, names)
    rotations, moved = t_pose(names, parents, places)
    posed = skin(body, joints, weights, rotations, places, moved)
    floor = np.array([0.0, posed[:, 1].min(), 0.0])
    write_glb(out / f"{name}.glb", name, posed - floor, triangles, joints, weights, names, parents, moved - floor)


def shorten_motion(source, target):
    """The same motion with angles to a hundredth of a degree and places to a thousandth of a unit."""
    lines = []
    for line in source.read_text().splitlines():
        words = line.split()
        if line.startswith(("#", ":")) or len(words) < 2:
            lines.append("# mocap.cs.cmu.edu" if line.startswith("#") else line.strip())
            continue
        lines.append(" ".join([words[0]] + [f"{float(word):.{3 if words[0] == 'root' else 2}f}" for word in words[1:]]))
    target.write_text("\n".join(lines) + "\n")


def axis_rotations(axis, degrees):
    """(..., 3, 3) rotations about x, y or z (0, 1, 2)."""
    angle = np.radians(degrees)
    result = np.zeros(np.shape(angle) + (3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result[..., axis, axis] = 1
    result[..., i, i] = result[..., j, j] = np.cos(angle)
    result[..., j, i] = np.sin(angle)
    result[..., i, j] = -result[..., j, i]
    return result


def read_bvh(path):
    """Names, parents, offsets, (T x 3) places of the root, (T x joints x 3 x 3) world rotations, the frame time. The root
    has channels X Y Z and all joints Z Y X, as Reallusion writes them."""
    head, motion = path.read_text().split("MOTION")
    names, parents, offsets, open_joints = [], [], [], []
    for line in head.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] in ("ROOT", "JOINT"):
            parents.append(open_joints[-1] if open_joints else -1)
            names.append(words[1])
            offsets.append(None)
            current = len(names) - 1
        elif words[0] == "End":
            current = None
        elif words[0] == "{":
            open_joints.append(current)
        elif words[0] == "}":
            open_joints.pop()
        elif words[0] == "OFFSET" and current is not None:
            offsets[current] = [float(word) for word in words[1:]]
    lines = motion.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("Frame Time"))
    rows = np.array([[float(word) for word in line.split()] for line in lines[start + 1:] if line.strip()])
    angles = rows[:, 3:].reshape(len(rows), len(names), 3)
    local = axis_rotations(2, angles[..., 0]) @ axis_rotations(1, angles[..., 1]) @ axis_rotations(0, angles[..., 2])
    world = local.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            world[:, joint] = world[:, parent] @ local[:, joint]
    return names, parents, np.array(offsets), rows[:, :3], world, float(lines[start].split(":")[1])


def t_pose_rotation(name, shoulder):
    """How Reallusion's joint is turned in a T pose: its bones go along its own y axis, which is up in the trunk, down in
    the legs and outwards in the arms. `shoulder`: of the clavicle, which the captures don't move."""
    side = 1 if name.startswith("CC_Base_L_") else -1
    joint = name.split("_")[-1]
    if joint == "Clavicle":
        return shoulder
    if joint in ("Upperarm", "Forearm", "Hand"):
        return axis_rotations(2, -90.0 * side)
    if joint in ("Thigh", "Calf"):
        return axis_rotations(2, 180.0)
    if joint in ("Foot", "ToeBase"):
        return axis_rotations(2, 180.0) @ axis_rotations(0, 70.0)
    return np.eye(3)


def shorten_bvh(source, target):
    """Every second frame, without fingers, face and twist joints, to a hundredth of a degree and of a centimetre, and
    with the T pose as the pose without rotations."""
    names, parents, offsets, places, world, frame_time = read_bvh(source)
    kept = [joint for joint, name in enumerate(names) if name.split("_")[-1] in KEPT_JOINTS]
    spine = names.index("CC_Base_Spine02")
    rest = [t_pose_rotation(name, world[0, spine].T @ world[0, joint]) for joint, name in enumerate(names)]
    world = np.stack([world[::2, joint] @ rest[joint].T for joint in range(len(names))], axis=1)

    columns = [places[::2]]
    for joint in kept:
        parent = parents[joint]
        local = world[:, joint] if parent < 0 else np.swapaxes(world[:, parent], 1, 2) @ world[:, joint]
        columns.append(np.degrees(np.stack([np.arctan2(local[:, 1, 0], local[:, 0, 0]),
                                            -np.arcsin(np.clip(local[:, 2, 0], -1, 1)),
                                            np.arctan2(local[:, 2, 1], local[:, 2, 2])], axis=1)))
    rows = np.concatenate(columns, axis=1)

    text = ["HIERARCHY"]

    def write(joint):
        parent = parents[joint]
        offset = offsets[joint] if parent < 0 else rest[parent] @ offsets[joint]
        children = [child for child in kept if parents[child] == joint]
        text.extend([f"{'ROOT' if parent < 0 else 'JOINT'} {names[joint]}", "{",
                     "OFFSET " + " ".join(f"{value + 0.0:.3f}" for value in offset.round(3)),
                     ("CHANNELS 6 Xposition Yposition Zposition " if parent < 0 else "CHANNELS 3 ") +
                     "Zrotation Yrotation Xrotation"])
        for child in children:
            write(child)
        if not children:
            end = next((child for child in range(joint + 1, len(names)) if parents[child] == joint), joint)
            text.extend(["End Site", "{", "OFFSET " + " ".join(f"{value:.3f}" for value in rest[joint] @ offsets[end]), "}"])
        text.append("}")

    write(kept[0])
    text += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {2 * frame_time:.6f}"]
    text += [" ".join(f"{value + 0.0:.2f}" for value in row) for row in rows.round(2)]
    target.write_text("\n".join(text) + "\n")


def main():
    makehuman, cmu = Path(sys.argv[1]), Path(sys.argv[2])
    out = Path(sys.argv[3]) if len(sys.argv) > 3 else Path(__file__).parent
    for name, targets in BODIES.items():
        make_body(name, targets, makehuman, out)
    for name, source in MOTIONS.items():
        (out / f"{name}.asf").write_text((cmu / f"{name}.asf").read_text())
        shorten_motion(cmu / f"{source}.amc", out / f"{name}.amc")
    for name, source in RETARGETED.items():
        shorten_bvh(cmu / f"{source}.bvh", out / f"{name}.bvh")


if __name__ == "__main__":
    main()
