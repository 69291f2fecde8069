// What the live page gets from `pleat up --page` (docs/report.md), and the frames that it keeps.
import type { Cloths, Frames, Obstacle } from "./data";

export interface LiveJob {
  id: string;
  live: boolean;
  scene: string;
  owner: string;
  state: string;
  ended: boolean;
  queue_place: number;
  frames: number;
  frames_complete: number;
  error: string;
  warnings: string[];
  detail: string;
  model: string;
  device: string;
  precision: string;
  coarse_vertices: number;
  fine_vertices: number;
  wall_s: number;
  penetrations: number;
  self_intersections: number;
  frame_errors: number;
}

export interface LiveState {
  jobs: LiveJob[];
  problem: string;
  notes: string[];
}

interface PackedArray {
  name: string;
  type: "float32" | "uint32";
  length: number;
}

interface Packed<About> {
  about: About;
  floats(name: string): Float32Array | undefined;
  words(name: string): Uint32Array | undefined;
}

/** Undoes what services/presentation/live/packed.hpp describes. */
export function unpack<About>(buffer: ArrayBuffer): Packed<About> {
  const size = new DataView(buffer).getUint32(0, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size))) as About & { arrays: PackedArray[] };
  const places = new Map<string, { offset: number; length: number }>();
  let offset = 4 + size;
  for (const { name, length } of about.arrays) {
    places.set(name, { offset, length });
    offset += 4 * length;
  }
  if (offset !== buffer.byteLength) throw new Error("a message has a wrong length");
  const find = <View>(make: new (buffer: ArrayBuffer, offset: number, length: number) => View, name: string): View | undefined => {
    const place = places.get(name);
    return place && new make(buffer, place.offset, place.length);
  };
  return { about, floats: (name) => find(Float32Array, name), words: (name) => find(Uint32Array, name) };
}

interface MeshesAbout {
  coarse_vertices: number;
  fine_vertices: number;
  obstacles: { name: string }[];
}

export interface FrameAbout {
  index: number;
  time_s: number;
  penetrations: number;
  self_intersections: number;
  stages: { name: string; ms: number }[];
  obstacles: { center?: number[]; radius?: number }[];
  error: string;
}

interface KeptFrame {
  about: FrameAbout;
  coarse: Float32Array;
  fine: Float32Array;
  obstacles: (Float32Array | undefined)[];
}

const kMostFrames = 240;
const kMostBytes = 256e6;

/** The meshes of a job and its newest frames, the oldest first. */
export class LiveFrames implements Cloths {
  readonly coarseFaces: Uint32Array;
  readonly fineFaces: Uint32Array;
  readonly coarse: Frames;
  readonly enhanced: Frames;
  readonly obstacles: Obstacle[];
  private readonly kept: KeptFrame[] = [];
  private readonly most: number;

  constructor(buffer: ArrayBuffer) {
    const packed = unpack<MeshesAbout>(buffer);
    const { coarse_vertices, fine_vertices, obstacles } = packed.about;
    this.coarseFaces = packed.words("coarse_faces") ?? new Uint32Array();
    this.fineFaces = packed.words("fine_faces") ?? new Uint32Array();
    this.coarse = this.sequence(coarse_vertices, (frame) => frame.coarse);
    this.enhanced = this.sequence(fine_vertices, (frame) => frame.fine);
    this.most = Math.max(2, Math.min(kMostFrames, Math.floor(kMostBytes / (12 * (coarse_vertices + fine_vertices)))));
    this.obstacles = obstacles.map(({ name }, i) => {
      const faces = packed.words(`obstacle_faces_${i}`);
      if (faces) return { name, faces, mesh: this.sequence(1 + faces.reduce((most, v) => Math.max(most, v), -1), (frame) => frame.obstacles[i]) };
      return {
        name,
        sphere: (frame) => {
          const { center, radius } = this.kept[frame].about.obstacles[i] ?? {};
          return center && radius ? { center, radius } : undefined;
        },
      };
    });
  }

  get count(): number {
    return this.kept.length;
  }

  about(frame: number): FrameAbout {
    return this.kept[frame].about;
  }

  /** Index of the newest frame of the job, -1 before the first. */
  get newest(): number {
    return this.kept.length > 0 ? this.kept[this.kept.length - 1].about.index : -1;
  }

  /** Returns false for a frame that shows nothing yet. */
  add(buffer: ArrayBuffer): boolean {
    const { about, floats } = unpack<FrameAbout>(buffer);
    const before = this.kept[this.kept.length - 1] as KeptFrame | undefined;
    const coarse = floats("coarse") ?? before?.coarse;
    const fine = floats("fine") ?? before?.fine;
    if (!coarse || !fine) return false;
    const obstacles = this.obstacles.map((_, i) => floats(`obstacle_${i}`) ?? before?.obstacles[i]);
    this.kept.push({ about, coarse, fine, obstacles });
    if (this.kept.length > this.most) this.kept.shift();
    return true;
  }

  private sequence(vertices: number, arrayOf: (frame: KeptFrame) => Float32Array | undefined): Frames {
    const { kept } = this;
    return {
      vertices,
      get frames() {
        return kept.length;
      },
      positions(frame, out) {
        const values = arrayOf(kept[frame]);
        if (values && values.length === out.length) out.set(values);
        return out;
      },
    };
  }
}
