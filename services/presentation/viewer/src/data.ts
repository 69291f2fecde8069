// Reads what services/presentation/report wrote into the page: one JSON object and base64 blobs (docs/report.md).

export interface SequenceMeta {
  blob: string;
  frames: number;
  vertices: number;
  step: number;
  origin: number[];
}

export interface SkinMeta {
  rest: SequenceMeta;
  joints_at_rest: SequenceMeta;
  joints: SequenceMeta;
  influences: string;
  weights: string;
}

export interface ObstacleMeta {
  name: string;
  centers?: number[];
  radii?: number[];
  sequence?: SequenceMeta;
  /** Which of the page's frames `sequence` has, for a skinned body; otherwise it has all. */
  sequence_frames?: number[];
  skin?: SkinMeta;
  faces?: string;
}

export interface StageFigures {
  median_ms: number;
  p95_ms: number;
}

export interface Report {
  [field: string]: unknown;
  title: string;
  frames: number;
  coarse_vertices: number;
  fine_vertices: number;
  coarse_faces: number;
  fine_faces: number;
  frame_time_s: number;
  wall_s: number;
  frames_per_s: number;
  penetrations: number;
  self_intersections: number;
  stages: Record<string, StageFigures>;
  model: string;
  device: string;
  precision: string;
  git_revision?: string;
  fidelity?: Record<string, { rmse_m: number; max_m: number }>;
}

export interface Meta {
  report: Report;
  stride: number;
  stages: { name: string; ms: number[] }[];
  counts: { name: string; values: number[] }[];
  coarse: SequenceMeta;
  enhanced: SequenceMeta;
  reference?: SequenceMeta;
  upsampling?: { parent_faces: string; barycentric: string };
  obstacles: ObstacleMeta[];
}

function element(id: string): HTMLElement {
  const found = document.getElementById(`pleat-${id}`);
  if (!found) throw new Error(`the page has no part "${id}"`);
  return found;
}

export function readMeta(): Meta {
  return JSON.parse(element("meta").textContent ?? "") as Meta;
}

function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  const native = (Uint8Array as unknown as { fromBase64?: (text: string) => Uint8Array<ArrayBuffer> }).fromBase64;
  if (native) return native.call(Uint8Array, text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; ++i) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** Inflates a blob, and takes its text out of the page: it is needed once. */
async function readBlob(name: string): Promise<Uint8Array> {
  const script = element(name);
  const deflated = fromBase64(script.textContent ?? "");
  script.remove();
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

export async function readWords(name: string): Promise<Uint32Array> {
  const planes = await readBlob(name);
  const count = planes.length / 4;
  const words = new Uint32Array(count);
  for (let i = 0; i < count; ++i) {
    words[i] = planes[i] | (planes[count + i] << 8) | (planes[2 * count + i] << 16) | (planes[3 * count + i] << 24);
  }
  return words;
}

export async function readFloats(name: string): Promise<Float32Array> {
  return new Float32Array((await readWords(name)).buffer);
}

/** Per vertex the corners of its faces with a smaller index, once per face, in compressed rows. */
function earlierMates(faces: Uint32Array, vertices: number): { offsets: Uint32Array; mates: Uint32Array } {
  const offsets = new Uint32Array(vertices + 1);
  const visit = (action: (later: number, earlier: number) => void) => {
    for (let f = 0; f < faces.length; f += 3) {
      for (let a = 0; a < 3; ++a) {
        for (let b = 0; b < 3; ++b) if (faces[f + a] > faces[f + b]) action(faces[f + a], faces[f + b]);
      }
    }
  };
  visit((later) => ++offsets[later + 1]);
  for (let v = 0; v < vertices; ++v) offsets[v + 1] += offsets[v];
  const mates = new Uint32Array(offsets[vertices]);
  const next = offsets.slice(0, vertices);
  visit((later, earlier) => (mates[next[later]++] = earlier));
  return { offsets, mates };
}

/** Frames of one mesh. */
export interface Frames {
  readonly frames: number;
  readonly vertices: number;
  /** Writes x0,y0,z0,x1,... of a frame, in metres, into `out`. */
  positions(frame: number, out: Float32Array): Float32Array;
}

/** Frames kept as 16-bit integers (order: frame, axis, vertex). */
export class Sequence implements Frames {
  readonly frames: number;
  readonly vertices: number;
  private readonly step: number;
  private readonly origin: number[];
  private readonly quantized: Uint16Array;

  private constructor(meta: SequenceMeta, quantized: Uint16Array) {
    this.frames = meta.frames;
    this.vertices = meta.vertices;
    this.step = meta.step;
    this.origin = meta.origin;
    this.quantized = quantized;
  }

  /** Undoes what services/presentation/report/encode.hpp describes. */
  static async read(meta: SequenceMeta, faces: Uint32Array): Promise<Sequence> {
    const planes = await readBlob(meta.blob);
    const { vertices } = meta;
    const perFrame = 3 * vertices;
    const total = perFrame * meta.frames;
    if (planes.length !== 2 * total) throw new Error(`part "${meta.blob}" has a wrong length`);
    const { offsets, mates } = earlierMates(faces, vertices);
    const q = new Uint16Array(total);
    const residuals = new Int16Array(vertices);
    for (let start = 0; start < total; start += vertices) {
      for (let v = 0; v < vertices; ++v) {
        const i = start + v;
        let sum = 0;
        let count = offsets[v + 1] - offsets[v];
        if (count > 0) {
          for (let k = offsets[v]; k < offsets[v + 1]; ++k) sum += residuals[mates[k]];
        } else if (v > 0) {
          sum = residuals[v - 1];
          count = 1;
        } else {
          count = 1;
        }
        const zigzag = planes[i] | (planes[total + i] << 8);
        // The typed arrays wrap modulo 2^16.
        residuals[v] = ((zigzag >>> 1) ^ -(zigzag & 1)) + Math.floor(sum / count);
        const before = i >= perFrame ? q[i - perFrame] : 0;
        const expected = i >= 2 * perFrame ? 2 * before - q[i - 2 * perFrame] : before;
        q[i] = expected + residuals[v];
      }
    }
    return new Sequence(meta, q);
  }

  positions(frame: number, out: Float32Array): Float32Array {
    const base = frame * 3 * this.vertices;
    for (let axis = 0; axis < 3; ++axis) {
      const origin = this.origin[3 * frame + axis];
      const start = base + axis * this.vertices;
      for (let v = 0; v < this.vertices; ++v) out[3 * v + axis] = origin + this.step * this.quantized[start + v];
    }
    return out;
  }
}

/** Barycentric upsampling of the coarse mesh to the fine vertices. */
export class Upsampling {
  constructor(
    private readonly coarseFaces: Uint32Array,
    private readonly parentFaces: Uint32Array,
    private readonly barycentric: Float32Array,
  ) {}

  apply(coarse: Float32Array, out: Float32Array): Float32Array {
    const { coarseFaces, parentFaces, barycentric } = this;
    for (let v = 0; v < parentFaces.length; ++v) {
      const a = 3 * coarseFaces[3 * parentFaces[v]];
      const b = 3 * coarseFaces[3 * parentFaces[v] + 1];
      const c = 3 * coarseFaces[3 * parentFaces[v] + 2];
      const wa = barycentric[3 * v];
      const wb = barycentric[3 * v + 1];
      const wc = barycentric[3 * v + 2];
      for (let axis = 0; axis < 3; ++axis) {
        out[3 * v + axis] = wa * coarse[a + axis] + wb * coarse[b + axis] + wc * coarse[c + axis];
      }
    }
    return out;
  }
}

const kInfluences = 4;
const kNoFaces = new Uint32Array(0);

/** A body that follows joints: linear blend skinning. Frames in which it is elsewhere have their points. */
export class SkinnedBody implements Frames {
  readonly frames: number;
  readonly vertices: number;
  private readonly rest: Float32Array;
  /** Of each joint at rest: its place. */
  private readonly pivots: Float32Array;
  /** Rows of the 3 x 4 matrices of all joints, in the frame that was asked for last. */
  private readonly matrices: Float32Array;
  private readonly markers: Float32Array;

  private constructor(
    rest: Sequence,
    atRest: Sequence,
    private readonly joints: Sequence,
    private readonly influences: Uint32Array,
    private readonly weights: Float32Array,
    private readonly elsewhere: Map<number, number>,
    private readonly points?: Sequence,
  ) {
    this.frames = joints.frames;
    this.vertices = rest.vertices;
    this.rest = rest.positions(0, new Float32Array(3 * rest.vertices));
    this.pivots = atRest.positions(0, new Float32Array(3 * atRest.vertices));
    this.markers = new Float32Array(3 * joints.vertices);
    this.matrices = new Float32Array(4 * joints.vertices);
  }

  static async read(meta: SkinMeta, faces: Uint32Array, points?: Sequence, frames?: number[]): Promise<SkinnedBody> {
    const [rest, atRest, joints, influences, words] = await Promise.all([
      Sequence.read(meta.rest, faces),
      Sequence.read(meta.joints_at_rest, kNoFaces),
      Sequence.read(meta.joints, kNoFaces),
      readWords(meta.influences),
      readWords(meta.weights),
    ]);
    const weights = new Float32Array(words.length);
    for (let i = 0; i < words.length; i += kInfluences) {
      let sum = 0;
      for (let k = i; k < i + kInfluences; ++k) sum += words[k];
      for (let k = i; k < i + kInfluences; ++k) weights[k] = words[k] / sum;
    }
    const elsewhere = new Map((frames ?? []).map((frame, index) => [frame, index]));
    return new SkinnedBody(rest, atRest, joints, influences, weights, elsewhere, points);
  }

  positions(frame: number, out: Float32Array): Float32Array {
    const stored = this.elsewhere.get(frame);
    if (stored !== undefined && this.points) return this.points.positions(stored, out);
    this.pose(frame);
    const { rest, influences, weights, matrices } = this;
    for (let v = 0; v < this.vertices; ++v) {
      const x = rest[3 * v];
      const y = rest[3 * v + 1];
      const z = rest[3 * v + 2];
      let px = 0;
      let py = 0;
      let pz = 0;
      for (let k = kInfluences * v; k < kInfluences * (v + 1); ++k) {
        const w = weights[k];
        if (w === 0) continue;
        const m = 12 * influences[k];
        px += w * (matrices[m] * x + matrices[m + 1] * y + matrices[m + 2] * z + matrices[m + 3]);
        py += w * (matrices[m + 4] * x + matrices[m + 5] * y + matrices[m + 6] * z + matrices[m + 7]);
        pz += w * (matrices[m + 8] * x + matrices[m + 9] * y + matrices[m + 10] * z + matrices[m + 11]);
      }
      out[3 * v] = px;
      out[3 * v + 1] = py;
      out[3 * v + 2] = pz;
    }
    return out;
  }

  /** Of the three points of each joint: its place, and on its x and y axes, which are those of the world at rest. */
  private pose(frame: number): void {
    const { markers, matrices, pivots } = this;
    this.joints.positions(frame, markers);
    for (let i = 0; i < markers.length; i += 9) {
      const x = unit([markers[i + 3] - markers[i], markers[i + 4] - markers[i + 1], markers[i + 5] - markers[i + 2]]);
      const toY = [markers[i + 6] - markers[i], markers[i + 7] - markers[i + 1], markers[i + 8] - markers[i + 2]];
      const z = unit(cross(x, toY));
      const y = cross(z, x);
      for (let row = 0; row < 3; ++row) {
        const m = (4 * i) / 3 + 4 * row;
        matrices[m] = x[row];
        matrices[m + 1] = y[row];
        matrices[m + 2] = z[row];
        matrices[m + 3] = markers[i + row] - (x[row] * pivots[i] + y[row] * pivots[i + 1] + z[row] * pivots[i + 2]);
      }
    }
  }
}

function cross(a: number[], b: number[]): number[] {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(a: number[]): number[] {
  const length = Math.hypot(a[0], a[1], a[2]) || 1;
  return [a[0] / length, a[1] / length, a[2] / length];
}

export interface Sphere {
  center: ArrayLike<number>;
  radius: number;
}

/** A mesh, or a sphere; undefined where nothing is known of it in a frame. */
export interface Obstacle {
  name: string;
  faces?: Uint32Array;
  mesh?: Frames;
  sphere?(frame: number): Sphere | undefined;
}

/** What the 3D views show. */
export interface Cloths {
  coarseFaces: Uint32Array;
  fineFaces: Uint32Array;
  coarse: Frames;
  enhanced: Frames;
  reference?: Frames;
  obstacles: Obstacle[];
}

/** All that a report shows, decoded. */
export interface Dataset extends Cloths {
  meta: Meta;
  upsampling?: Upsampling;
}

export async function readDataset(): Promise<Dataset> {
  const meta = readMeta();
  const [coarseFaces, fineFaces] = await Promise.all([readWords("coarse_faces"), readWords("fine_faces")]);
  const [coarse, enhanced, reference] = await Promise.all([
    Sequence.read(meta.coarse, coarseFaces),
    Sequence.read(meta.enhanced, fineFaces),
    meta.reference && Sequence.read(meta.reference, fineFaces),
  ]);
  const upsampling =
    meta.upsampling &&
    new Upsampling(coarseFaces, await readWords(meta.upsampling.parent_faces), await readFloats(meta.upsampling.barycentric));
  const obstacles = await Promise.all(
    meta.obstacles.map(async ({ name, centers, radii, sequence, ...mesh }): Promise<Obstacle> => {
      const faces = mesh.faces ? await readWords(mesh.faces) : undefined;
      const stored = sequence && faces && (await Sequence.read(sequence, faces));
      const skinned = mesh.skin && faces && (await SkinnedBody.read(mesh.skin, faces, stored, mesh.sequence_frames));
      if (faces && (skinned || stored)) return { name, faces, mesh: skinned ?? stored };
      if (!centers || !radii) return { name };
      return { name, sphere: (frame) => ({ center: centers.slice(3 * frame, 3 * frame + 3), radius: radii[frame] }) };
    }),
  );
  return { meta, coarseFaces, fineFaces, coarse, enhanced, reference, upsampling, obstacles };
}
