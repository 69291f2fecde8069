// Two small charts on 2D canvases, with a shared time axis and a playhead. Dragging on one sets the frame.
import { percentile, roundUp } from "./geometry";

export interface Series {
  name: string;
  color: string;
  values: ArrayLike<number>;
}

export interface ChartOptions {
  stacked: boolean;
  height: number;
  onFrame: (index: number) => void;
}

const kLeft = 30;
const kBottom = 16;
const kTop = 6;

function cssColor(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export class Chart {
  readonly canvas = document.createElement("canvas");
  /** Of the first column, for the labels. */
  first = 0;
  private top = 1;
  private current = 0;

  constructor(
    readonly series: Series[],
    private readonly count: number,
    private readonly options: ChartOptions,
  ) {
    this.canvas.className = "chart";
    this.canvas.style.setProperty("--tall", `${options.height}px`);
    this.canvas.style.setProperty("--low", `${Math.round(0.72 * options.height)}px`);
    this.rescale();
    const seek = (event: PointerEvent) => {
      const bounds = this.canvas.getBoundingClientRect();
      const share = (event.clientX - bounds.left - kLeft) / Math.max(1, bounds.width - kLeft);
      options.onFrame(Math.max(0, Math.min(count - 1, Math.floor(share * count))));
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) seek(event);
    });
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  /** To the values that `series` have now. */
  rescale(): void {
    const { series, count, options } = this;
    const totals = new Float64Array(count);
    for (const { values } of series) {
      for (let i = 0; i < count; ++i) totals[i] = options.stacked ? totals[i] + values[i] : Math.max(totals[i], values[i]);
    }
    // One slow frame must not flatten all others: beyond twice the 95th percentile a column leaves the chart.
    const most = Math.max(...totals, 1e-9);
    this.top = Math.min(most * 1.08, 2 * percentile(totals, 0.95) || most);
  }

  setCurrent(index: number): void {
    this.current = index;
    this.draw();
  }

  draw(): void {
    const { canvas, series, count, top } = this;
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (width < 1 || height < 1) return;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d")!;
    pen.scale(ratio, ratio);
    const plotWidth = width - kLeft;
    const plotHeight = height - kBottom - kTop;
    const x = (index: number) => kLeft + (plotWidth * index) / count;
    const y = (value: number) => kTop + plotHeight * (1 - Math.min(value / top, 1));

    pen.font = `11px ${getComputedStyle(document.body).fontFamily}`;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    const step = roundUp(top / (plotHeight / 26));
    for (let value = 0; value <= top; value += step) {
      pen.fillStyle = cssColor("--soft");
      pen.fillText(formatNumber(value), kLeft - 6, y(value));
      pen.fillStyle = cssColor("--line");
      pen.fillRect(kLeft, Math.round(y(value)), plotWidth, 1);
    }
    pen.textBaseline = "alphabetic";
    pen.fillStyle = cssColor("--soft");
    const frameStep = Math.max(1, Math.round(roundUp(count / 5)));
    for (let frame = (frameStep - (this.first % frameStep)) % frameStep; frame < count; frame += frameStep) {
      pen.textAlign = frame === 0 ? "left" : "center";
      if (x(frame) < width - 10) pen.fillText(String(this.first + frame), x(frame), height - 3);
    }

    const base = new Float64Array(count);
    for (const { color, values } of series) {
      pen.fillStyle = pen.strokeStyle = cssColor(color);
      pen.beginPath();
      if (this.options.stacked) {
        for (let i = 0; i < count; ++i) {
          pen.lineTo(x(i), y(base[i] + values[i]));
          pen.lineTo(x(i + 1), y(base[i] + values[i]));
        }
        for (let i = count - 1; i >= 0; --i) {
          pen.lineTo(x(i + 1), y(base[i]));
          pen.lineTo(x(i), y(base[i]));
        }
        pen.fill();
        for (let i = 0; i < count; ++i) base[i] += values[i];
      } else {
        pen.lineWidth = 1.75;
        pen.lineJoin = "round";
        for (let i = 0; i < count; ++i) pen.lineTo(x(i + 0.5), y(values[i]));
        pen.stroke();
      }
    }
    pen.fillStyle = cssColor("--ink");
    pen.fillRect(x(this.current + 0.5) - 0.75, kTop - 3, 1.5, plotHeight + 3);
  }
}

export function formatNumber(value: number): string {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 100) return value.toFixed(0);
  if (size >= 10) return String(+value.toFixed(1));
  if (size >= 1) return String(+value.toFixed(2));
  return String(+value.toPrecision(2));
}
