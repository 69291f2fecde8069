# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloth through Pleat: a whole frame range into a point cache, or frame by frame while the time line moves."""

import os
import time

import bpy
from bpy.app.handlers import persistent

from . import cloth as cloths
from . import exchange
from .bridge import Bridge, BridgeError

_CHUNK = 16  # frames that go to Pleat at once
_AHEAD = 4  # chunks that Blender is ahead of Pleat


def preferences(context):
    return context.preferences.addons[__package__].preferences


def start_bridge(cloth, context):
    settings = cloth.pleat
    model = settings.model if settings.detail != "fold" else ""
    return Bridge(preferences(context).program, settings.detail, bpy.path.abspath(model) if "/" in model else model)


class Opened:
    """A session of Pleat for one cloth object."""

    def __init__(self, cloth, context, bridge, folder):
        scene = context.scene
        self.bridge, self.folder, self.cloth = bridge, folder, cloth
        self.garment = cloths.Garment(cloth, context)
        scale = self.garment.scale
        self.rest, self.mesh = os.path.join(folder, "rest.obj"), os.path.join(folder, "fine.obj")
        self.garment.write(self.rest)
        depsgraph = context.evaluated_depsgraph_get()
        self.moved, described = {}, []
        for k, thing in enumerate(cloths.obstacles(cloth, context)):
            path = os.path.join(folder, f"obstacle-{k}.obj")
            points = cloths.write_obstacle(thing, depsgraph, scale, path)
            moved = cloths.moves(thing)
            if moved:
                self.moved[thing.name] = (thing, points)
            described.append({"name": thing.name, "mesh": path, "moved": moved})
        request = {
            "rest": self.rest,
            "mesh": self.mesh,
            "frame_time_s": scene.render.fps_base / scene.render.fps,
            "held": self.garment.held(cloth),
            "obstacles": described,
            "rounds": cloth.pleat.rounds,
        }
        if cloth.pleat.fabric != "DEFAULT":
            request["material"] = cloth.pleat.fabric
        bridge.send({"open": request})

    def answer(self, values, context):
        """What Pleat says to `open`; the fine object."""
        self.notes = self.garment.notes + values["notes"]
        return cloths.make_fine(self.cloth, self.garment, self.mesh, values["rounds"], context)


class Writers:
    """The point caches that go to Pleat: the cloth, and the obstacles that move."""

    def __init__(self, opened, prefix):
        self._opened = opened
        folder = opened.folder
        self.coarse = exchange.Pc2Writer(os.path.join(folder, prefix + "coarse.pc2"), len(opened.garment.points))
        self.moved = {
            name: exchange.Pc2Writer(os.path.join(folder, f"{prefix}obstacle-{k}.pc2"), points)
            for k, (name, (_, points)) in enumerate(opened.moved.items())
        }

    def add(self, depsgraph):
        scale = self._opened.garment.scale
        self.coarse.add(cloths.evaluated_points(self._opened.cloth, depsgraph, scale))
        for name, writer in self.moved.items():
            writer.add(cloths.evaluated_points(self._opened.moved[name][0], depsgraph, scale))

    def request(self, fine, first, count):
        for writer in (self.coarse, *self.moved.values()):
            writer.flush()
        return {
            "coarse": self.coarse.path,
            "obstacles": {name: writer.path for name, writer in self.moved.items()},
            "fine": fine,
            "first": first,
            "count": count,
        }

    def close(self):
        for writer in (self.coarse, *self.moved.values()):
            writer.close()


class Bake:
    """Bakes the scene's frame range. steps() does the work in small pieces, so that Blender stays alive between them."""

    def __init__(self, cloth, context):
        self.cloth, self.context = cloth, context
        self.done = self.total = self.chunks = 0
        self.intersections = self.failed = self.unclean = 0
        self.notes = []
        self.text = "starts Pleat"

    def steps(self):
        scene, cloth = self.context.scene, self.cloth
        first, last = scene.frame_start, scene.frame_end
        self.total = last - first + 1
        before = scene.frame_current
        live.stop(cloth)
        cloth.pleat["live"] = False
        folder = cloths.cache_folder(cloth, cloth.pleat.folder)
        bridge = start_bridge(cloth, self.context)
        fine, done = None, False
        try:
            while not self._said(bridge, "ready"):
                yield
            scene.frame_set(first)
            opened = Opened(cloth, self.context, bridge, folder)
            values = None
            while not values:
                values = self._said(bridge, "opened")
                yield
            fine = opened.answer(values, self.context)
            self.notes = opened.notes
            self.text = "frames"
            cache = os.path.join(folder, "fine.pc2")
            with cloths.kept_simulation(cloth, self.context):
                cloths.show_coarse(cloth)
                for frame in range(cloths.first_simulated(cloth, first), first):
                    scene.frame_set(frame)
                    yield
                yield from self._frames(bridge, opened, cache, first, last)
            cloths.play(fine, cache, first)
            done = True
        finally:
            bridge.close()
            scene.frame_set(before)
            if not done:
                self._undo(fine)

    def _frames(self, bridge, opened, cache, first, last):
        writers = Writers(opened, "")
        sent = 0
        try:
            for frame in range(first, last + 1):
                self.context.scene.frame_set(frame)
                writers.add(self.context.evaluated_depsgraph_get())
                ready = frame - first + 1
                if ready - sent == _CHUNK or frame == last:
                    bridge.send({"enhance": writers.request(cache, sent, ready - sent)})
                    sent = ready
                self._hear(bridge)
                yield
                while sent - self.done > _AHEAD * _CHUNK:
                    self._hear(bridge, 0.01)
                    yield
            # The last word of a chunk comes when its frames are in the file.
            while self.chunks < -(-self.total // _CHUNK):
                self._hear(bridge, 0.01)
                yield
        finally:
            writers.close()

    def _undo(self, fine):
        """Without a bake there is no fine mesh."""
        if fine:
            mesh = fine.data
            bpy.data.objects.remove(fine)
            bpy.data.meshes.remove(mesh)
        cloths.show_cloth(self.cloth)

    def _said(self, bridge, kind):
        answer = bridge.poll(0.05)
        return answer[1] or True if answer and answer[0] == kind else None

    def _hear(self, bridge, timeout=0.0):
        while True:
            answer = bridge.poll(timeout)
            if not answer:
                return
            kind, values = answer
            if kind == "frame":
                self.done += 1
                self.intersections += values["self_intersections"] + values["penetrations"]
                self.failed += "error" in values
                self.unclean += values["input_intersects"]
            elif kind == "enhanced":
                self.chunks += 1
            timeout = 0.0

    def summary(self):
        text = f"{self.done} frames"
        if self.intersections:
            text += f", {self.intersections} intersections are left"
            if self.unclean:
                text += f" ({self.unclean} coarse frames were not free of them: does the cloth collide with itself?)"
        if self.failed:
            text += f", {self.failed} frames could not be made"
        return "; ".join([text, *self.notes])


class Live:
    """The cloth objects whose fine mesh follows the time line."""

    def __init__(self):
        self._sessions = {}  # name: (bridge, opened, fine object's name)
        self._last = {}
        self.error = {}

    def names(self):
        return list(self._sessions)

    def start(self, cloth, context):
        self.stop(cloth)
        self.error.pop(cloth.name, None)
        folder = cloths.cache_folder(cloth, cloth.pleat.folder)
        bridge = start_bridge(cloth, context)
        try:
            bridge.wait("ready")
            opened = Opened(cloth, context, bridge, folder)
            fine = opened.answer(bridge.wait("opened"), context)
        except Exception:
            bridge.close()
            raise
        cloths.show_coarse(cloth)
        scene = context.scene
        current = scene.frame_current
        for frame in range(cloths.first_simulated(cloth, current), current):
            scene.frame_set(frame)
        self._sessions[cloth.name] = (bridge, opened, fine.name)
        scene.frame_set(current)

    def stop(self, cloth):
        session = self._sessions.pop(cloth.name, None)
        self._last.pop(cloth.name, None)
        if session:
            session[0].close()

    def stop_all(self):
        for name in self.names():
            cloth = bpy.data.objects.get(name)
            if cloth:
                self.stop(cloth)
            else:
                self._sessions.pop(name)[0].close()

    def update(self, scene, depsgraph):
        for name, (bridge, opened, fine_name) in list(self._sessions.items()):
            frame, last = scene.frame_current, self._last.get(name)
            fine = bpy.data.objects.get(fine_name)
            if frame == last or fine is None:
                continue
            try:
                writers = Writers(opened, "live-")
                writers.add(depsgraph)
                cache = os.path.join(opened.folder, "live-fine.pc2")
                request = writers.request(cache, 0, 1)
                writers.close()
                # The cloth's past is of use where the time goes on.
                request["restart"] = last is None or frame != last + 1
                bridge.send({"enhance": request})
                bridge.wait("enhanced", 30)
                fine.data.vertices.foreach_set("co", exchange.read_pc2(cache, 0).ravel())
                fine.data.update()
                self._last[name] = frame
            except (BridgeError, OSError, ValueError) as error:
                self.error[name] = str(error)
                self._sessions.pop(name)
                bridge.close()


live = Live()


@persistent
def on_frame(scene, depsgraph):
    live.update(scene, depsgraph)


@persistent
def on_load(*_):
    live.stop_all()


def bake_now(cloth, context):
    """Bakes without a window: blocks until it is done. What the summary says."""
    bake = Bake(cloth, context)
    for _ in bake.steps():
        pass
    return bake


def steps_for(steps, seconds):
    """Goes on with the steps for so long; True at their end."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            next(steps)
        except StopIteration:
            return True
    return False
