// Per-frame geometry on flat arrays.

/** Area-weighted unit vertex normals into `normals`. */
export function vertexNormals(positions: Float32Array, faces: Uint32Array, normals: Float32Array): void {
  normals.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f];
    const b = 3 * faces[f + 1];
    const c = 3 * faces[f + 2];
    const ux = positions[b] - positions[a];
    const uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a];
    const vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy;
    const ny = uz * vx - ux * vz;
    const nz = ux * vy - uy * vx;
    for (const corner of [a, b, c]) {
      normals[corner] += nx;
      normals[corner + 1] += ny;
      normals[corner + 2] += nz;
    }
  }
  for (let v = 0; v < normals.length; v += 3) {
    const length = Math.hypot(normals[v], normals[v + 1], normals[v + 2]) || 1;
    normals[v] /= length;
    normals[v + 1] /= length;
    normals[v + 2] /= length;
  }
}

/**
 * Mean curvature in 1/m by the umbrella operator, positive in valleys seen from the front. Boundary vertices get 0: their
 * neighbours lie on one side.
 */
export class Curvature {
  private readonly boundary: Uint8Array;
  private readonly sums: Float32Array;
  private readonly counts: Float32Array;

  constructor(
    private readonly faces: Uint32Array,
    vertices: number,
  ) {
    this.boundary = new Uint8Array(vertices);
    this.sums = new Float32Array(3 * vertices);
    this.counts = new Float32Array(vertices);
    const edges = new Map<number, number>();
    for (let f = 0; f < faces.length; f += 3) {
      for (let k = 0; k < 3; ++k) {
        const a = faces[f + k];
        const b = faces[f + ((k + 1) % 3)];
        const key = Math.min(a, b) * vertices + Math.max(a, b);
        edges.set(key, (edges.get(key) ?? 0) + 1);
        this.counts[a] += 2;
      }
    }
    for (const [key, count] of edges) {
      if (count !== 1) continue;
      this.boundary[Math.floor(key / vertices)] = 1;
      this.boundary[key % vertices] = 1;
    }
  }

  compute(positions: Float32Array, normals: Float32Array, out: Float32Array): void {
    const { faces, sums, counts, boundary } = this;
    sums.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f];
      const b = 3 * faces[f + 1];
      const c = 3 * faces[f + 2];
      for (let axis = 0; axis < 3; ++axis) {
        const pa = positions[a + axis];
        const pb = positions[b + axis];
        const pc = positions[c + axis];
        sums[a + axis] += pb + pc;
        sums[b + axis] += pc + pa;
        sums[c + axis] += pa + pb;
      }
    }
    // Edge lengths hardly change in time: the mean over the mesh serves as scale for all vertices.
    let edge = 0;
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f];
      const b = 3 * faces[f + 1];
      edge += Math.hypot(positions[a] - positions[b], positions[a + 1] - positions[b + 1], positions[a + 2] - positions[b + 2]);
    }
    edge /= Math.max(1, faces.length / 3);
    const scale = 4 / (edge * edge);
    for (let v = 0; v < out.length; ++v) {
      if (boundary[v] || counts[v] === 0) {
        out[v] = 0;
        continue;
      }
      const i = 3 * v;
      const inverse = 1 / counts[v];
      out[v] =
        scale *
        ((sums[i] * inverse - positions[i]) * normals[i] +
          (sums[i + 1] * inverse - positions[i + 1]) * normals[i + 1] +
          (sums[i + 2] * inverse - positions[i + 2]) * normals[i + 2]);
    }
  }
}

/** Distance of vertex v in `a` to vertex v in `b`, metres. */
export function distances(a: Float32Array, b: Float32Array, out: Float32Array): Float32Array {
  for (let v = 0; v < out.length; ++v) {
    const i = 3 * v;
    out[v] = Math.hypot(a[i] - b[i], a[i + 1] - b[i + 1], a[i + 2] - b[i + 2]);
  }
  return out;
}

export function rms(values: Float32Array): number {
  let sum = 0;
  for (const value of values) sum += value * value;
  return Math.sqrt(sum / Math.max(1, values.length));
}

export function maximum(values: ArrayLike<number>): number {
  let most = 0;
  for (let i = 0; i < values.length; ++i) most = Math.max(most, values[i]);
  return most;
}

/** The smallest of 1, 2, 5 times a power of ten that is at least `value`. */
export function roundUp(value: number): number {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  for (const factor of [1, 2, 5, 10]) if (factor * power >= value * 0.999) return factor * power;
  return 10 * power;
}

/** Linear interpolation between order statistics. */
export function percentile(values: ArrayLike<number>, share: number): number {
  const sorted = Float64Array.from(values).sort();
  if (sorted.length === 0) return 0;
  const place = share * (sorted.length - 1);
  const below = Math.floor(place);
  const above = Math.min(below + 1, sorted.length - 1);
  return sorted[below] + (sorted[above] - sorted[below]) * (place - below);
}
