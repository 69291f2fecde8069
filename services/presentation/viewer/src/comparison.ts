// What the map view compares, and the figures of every frame.
import type { Dataset } from "./data";
import { distances, maximum, percentile, rms, roundUp } from "./geometry";

export type MapKind = "enhanced" | "upsampled" | "detail";

export interface MapInfo {
  kind: MapKind;
  button: string;
  title: string;
}

export interface FrameSeries {
  rms: Float32Array;
  max: Float32Array;
}

/** Computes distances per frame; `kinds` are those that the data allow, the first is the default. */
export class Comparison {
  readonly kinds: MapInfo[] = [];
  /** Per kind, over the stored frames. */
  readonly series = new Map<MapKind, FrameSeries>();
  /** Metres at the top of the colour scale; the maps against the reference share one, so that they compare. */
  readonly scale = new Map<MapKind, number>();
  private readonly coarse: Float32Array;
  private readonly other: Float32Array;

  constructor(private readonly data: Dataset) {
    const vertices = data.enhanced.vertices;
    this.coarse = new Float32Array(3 * data.coarse.vertices);
    this.other = new Float32Array(3 * vertices);
    if (data.reference) {
      this.kinds.push({ kind: "enhanced", button: "Enhanced", title: "Distance of the enhanced to the simulated cloth" });
    }
    if (data.reference && data.upsampling) {
      this.kinds.push({ kind: "upsampled", button: "Upsampled", title: "Distance of the plainly upsampled coarse to the simulated cloth" });
    }
    if (data.upsampling) {
      this.kinds.push({ kind: "detail", button: "Added detail", title: "Distance of the enhanced to the plainly upsampled coarse cloth" });
    }
    const positions = new Float32Array(3 * vertices);
    const values = new Float32Array(vertices);
    const high = new Map<MapKind, number>();
    const sampling = Math.ceil(data.enhanced.frames / 16);
    for (const { kind } of this.kinds) {
      const series = { rms: new Float32Array(data.enhanced.frames), max: new Float32Array(data.enhanced.frames) };
      const perFrame: number[] = [];
      for (let frame = 0; frame < data.enhanced.frames; ++frame) {
        this.compute(kind, frame, positions, values);
        series.rms[frame] = rms(values);
        series.max[frame] = maximum(values);
        if (frame % sampling === 0) perFrame.push(percentile(values, 0.98));
      }
      this.series.set(kind, series);
      high.set(kind, percentile(perFrame, 0.9));
    }
    const againstReference = roundUp(Math.max(high.get("enhanced") ?? 0, 0.3 * (high.get("upsampled") ?? 0)) || 0.001);
    this.scale.set("enhanced", againstReference);
    this.scale.set("upsampled", againstReference);
    this.scale.set("detail", roundUp(high.get("detail") || 0.001));
  }

  /** Fills the positions to draw and the distance of each vertex (metres). */
  compute(kind: MapKind, frame: number, positions: Float32Array, values: Float32Array): void {
    const { data, other } = this;
    if (kind === "upsampled") {
      data.upsampling!.apply(data.coarse.positions(frame, this.coarse), positions);
    } else {
      data.enhanced.positions(frame, positions);
    }
    if (kind === "detail") {
      data.upsampling!.apply(data.coarse.positions(frame, this.coarse), other);
    } else {
      data.reference!.positions(frame, other);
    }
    distances(positions, other, values);
  }
}
