// The time line: which frame is shown, and when the next one is due.
import type { Dataset } from "./data";

export const kPlay = '<svg viewBox="0 0 18 18"><path d="M5 2.8v12.4L15.2 9z"/></svg>';
export const kPause = '<svg viewBox="0 0 18 18"><path d="M4.5 3h3.2v12H4.5zM10.3 3h3.2v12h-3.2z"/></svg>';

export class Player {
  /** Index among the stored frames. */
  stored = 0;
  private on = false;
  private due = 0;
  private readonly slider = document.getElementById("slider") as HTMLInputElement;
  private readonly strip = document.getElementById("strip") as HTMLCanvasElement;
  private readonly button = document.getElementById("play") as HTMLButtonElement;
  private readonly speed = document.getElementById("speed") as HTMLSelectElement;
  private readonly count: number;
  /** Stored frames in which something was counted, for example a penetration. */
  private readonly marks: number[];

  constructor(
    private readonly data: Dataset,
    private readonly onShow: (stored: number) => void,
  ) {
    this.count = data.enhanced.frames;
    this.slider.max = String(this.count - 1);
    const found = new Set<number>();
    for (const { values } of data.meta.counts) {
      values.forEach((value, index) => value > 0 && found.add(Math.min(this.count - 1, Math.floor(index / data.meta.stride))));
    }
    this.marks = [...found];
    this.slider.addEventListener("input", () => {
      this.playing = false;
      this.show(Number(this.slider.value));
    });
    this.button.addEventListener("click", () => (this.playing = !this.playing));
    new ResizeObserver(() => this.draw()).observe(this.strip);
    this.playing = false;
  }

  get playing(): boolean {
    return this.on;
  }

  set playing(on: boolean) {
    this.on = on;
    this.due = 0;
    this.button.innerHTML = on ? kPause : kPlay;
    this.button.setAttribute("aria-label", on ? "Pause" : "Play");
  }

  show(stored: number): void {
    this.stored = Math.max(0, Math.min(this.count - 1, stored));
    const { report, stride } = this.data.meta;
    const index = this.stored * stride;
    this.slider.value = String(this.stored);
    document.getElementById("frame")!.textContent = `Frame ${index} / ${report.frames - 1}`;
    document.getElementById("time")!.textContent = `${(index * report.frame_time_s).toFixed(2)} s`;
    this.draw();
    this.onShow(this.stored);
  }

  /** now: milliseconds of requestAnimationFrame. Never shows more than one frame a call: slow machines play slower. */
  advance(now: number): void {
    if (!this.on) return;
    const interval = (1000 * this.data.meta.report.frame_time_s * this.data.meta.stride) / Number(this.speed.value);
    if (this.due === 0) this.due = now + interval;
    if (now < this.due) return;
    this.due = Math.max(this.due + interval, now);
    this.show((this.stored + 1) % this.count);
  }

  /** Handles the keys of the time line; returns whether it knew the key. */
  key(event: KeyboardEvent): boolean {
    const jump = event.shiftKey ? 10 : 1;
    const targets: Record<string, number> = {
      ArrowLeft: this.stored - jump,
      ArrowRight: this.stored + jump,
      Home: 0,
      End: this.count - 1,
    };
    if (event.key === " ") {
      this.playing = !this.playing;
    } else if (event.key in targets) {
      this.playing = false;
      this.show(targets[event.key]);
    } else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      const next = this.speed.selectedIndex + (event.key === "ArrowUp" ? 1 : -1);
      this.speed.selectedIndex = Math.max(0, Math.min(this.speed.length - 1, next));
    } else {
      return false;
    }
    return true;
  }

  /** The strip behind the slider: what has been played, a tick every ten frames, red where something was counted. */
  draw(): void {
    const { strip, count } = this;
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = strip;
    if (width < 1) return;
    strip.width = Math.round(width * ratio);
    strip.height = Math.round(height * ratio);
    const style = getComputedStyle(document.documentElement);
    const color = (name: string) => style.getPropertyValue(name).trim();
    const pen = strip.getContext("2d")!;
    pen.scale(ratio, ratio);
    // The thumb's centre moves between its half widths.
    const x = (stored: number) => 2 + ((width - 4) * stored) / Math.max(1, count - 1);
    pen.fillStyle = color("--panel");
    pen.fillRect(0, 0, width, height);
    pen.fillStyle = color("--accent");
    pen.globalAlpha = 0.16;
    pen.fillRect(0, 0, x(this.stored), height);
    pen.globalAlpha = 1;
    const { stride } = this.data.meta;
    const every = count > 400 ? 50 : 10;
    pen.fillStyle = color("--line");
    for (let stored = 0; stored < count; ++stored) {
      const tall = (stored * stride) % every === 0;
      if (tall || count < 200) pen.fillRect(x(stored) - 0.5, tall ? height - 16 : height - 7, 1, tall ? 16 : 7);
    }
    pen.fillStyle = color("--bad");
    for (const mark of this.marks) pen.fillRect(x(mark) - 1.5, 0, 3, 8);
  }
}
