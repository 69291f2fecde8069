// The live page: the jobs and sessions of a running coordinator. Publishes window.pleatLive, which tests drive.
import { Chart, formatNumber, type Series } from "./charts";
import { byId, setChips, ViewGrid } from "./grid";
import { LiveFrames, type LiveJob, type LiveState } from "./live_data";
import { card, kPalette, make, readable, tile } from "./panel";
import { kPause, kPlay } from "./player";
import { Stage } from "./views";

/** The page's interface for scripts. */
interface PleatLive {
  readonly jobs: LiveJob[];
  readonly problem: string;
  /** Id of the job that is shown. */
  selected: string | null;
  /** Index of the shown frame in its job, -1 before the first. */
  readonly frame: number;
  /** Frames that came since the job was selected. */
  readonly received: number;
  following: boolean;
  setCamera(azimuth: number, elevation: number, zoom?: number): void;
  render(): void;
}

declare global {
  interface Window {
    pleatLive: PleatLive;
  }
}

const kStateInterval = 1000;
const kColumns = 200;

const pause = (milliseconds: number) => new Promise((done) => setTimeout(done, milliseconds));

/** Draws the strip behind the slider: where frames had something wrong. */
function drawStrip(frames: LiveFrames | undefined): void {
  const strip = byId<HTMLCanvasElement>("strip");
  strip.width = strip.clientWidth;
  strip.height = strip.clientHeight;
  const style = getComputedStyle(document.documentElement);
  const pen = strip.getContext("2d")!;
  pen.fillStyle = style.getPropertyValue("--panel");
  pen.fillRect(0, 0, strip.width, strip.height);
  pen.fillStyle = style.getPropertyValue("--bad");
  for (let i = 0; frames && i < frames.count; ++i) {
    const { error, penetrations, self_intersections } = frames.about(i);
    if (error !== "" || penetrations + self_intersections > 0) {
      pen.fillRect(2 + ((strip.width - 4) * i) / Math.max(1, frames.count - 1) - 1.5, 0, 3, 8);
    }
  }
}

/** Times of the newest frames, and their table. */
class StageTimes {
  private readonly series: Series[] = [];
  private readonly values: Float32Array[] = [];
  private readonly cells: HTMLElement[] = [];
  private readonly chart: Chart;
  private filled = 0;

  constructor(section: HTMLElement, private readonly names: string[]) {
    const table = make("table");
    const body = table.createTBody();
    names.forEach((name, i) => {
      const values = new Float32Array(kColumns);
      const color = `--c${i % kPalette}`;
      this.values.push(values);
      this.series.push({ name, color, values });
      const row = body.insertRow();
      const label = row.insertCell();
      const swatch = make("i", "swatch");
      swatch.style.background = `var(${color})`;
      label.append(swatch, readable(name));
      this.cells.push(row.insertCell());
    });
    this.chart = new Chart(this.series, kColumns, { stacked: true, height: 150, onFrame: () => {} });
    section.append(this.chart.canvas, table);
  }

  add(stages: { name: string; ms: number }[], index: number): void {
    if (this.filled === kColumns) {
      for (const values of this.values) values.copyWithin(0, 1);
    } else {
      ++this.filled;
    }
    this.names.forEach((name, i) => {
      const ms = stages.find((stage) => stage.name === name)?.ms ?? 0;
      this.values[i][this.filled - 1] = ms;
      this.cells[i].textContent = ms.toFixed(2);
    });
    this.chart.first = index + 1 - this.filled;
    this.chart.rescale();
    this.chart.setCurrent(this.filled - 1);
  }
}

class LivePage {
  private readonly grid = new ViewGrid();
  private readonly side = byId("side");
  private readonly slider = byId<HTMLInputElement>("slider");
  private readonly play = byId("play");
  private readonly jobList = card(this.side, "Jobs and sessions", "");
  private readonly list = make("div", "jobs");
  private readonly figures = make("div", "tiles");
  private readonly stageCard: HTMLElement;
  private readonly messages = make("div", "messages");
  private state: LiveState = { jobs: [], problem: "", notes: [] };
  private selected: string | null = null;
  /** Changes with the selection, so that answers for an earlier one are dropped. */
  private turn = 0;
  private frames: LiveFrames | undefined;
  private times: StageTimes | undefined;
  private place = 0;
  private received = 0;
  private following = true;
  private touched = false;
  private rate = 0;
  private counted: { id: string; frames: number; at: number } | undefined;

  constructor() {
    document.body.classList.add("live");
    this.jobList.append(this.list);
    const figureCard = make("section", "card");
    figureCard.append(this.figures);
    this.side.append(figureCard);
    this.stageCard = card(this.side, "Stage times", "ms, newest frames");
    card(this.side, "Messages", "").append(this.messages);
    this.grid.addView("coarse", "");
    this.grid.addView("enhanced", "");
    this.grid.addTools((event) => this.key(event));
    this.play.addEventListener("click", () => this.setFollowing(!this.following));
    this.slider.addEventListener("input", () => {
      this.setFollowing(false);
      this.show(Number(this.slider.value));
    });
    this.setFollowing(true);
    this.describe();
    this.publish();
    byId("notice").hidden = true;
  }

  run(): void {
    void this.poll();
    const step = () => {
      this.grid.stage?.draw();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  private get job(): LiveJob | undefined {
    return this.state.jobs.find(({ id }) => id === this.selected);
  }

  private async poll(): Promise<void> {
    for (;;) {
      try {
        const answer = await fetch("state");
        if (!answer.ok) throw new Error((await answer.text()).trim());
        this.state = (await answer.json()) as LiveState;
      } catch {
        this.state = { jobs: [], problem: "`pleat up` does not answer", notes: this.state.notes };
      }
      this.measureRate();
      // What runs is shown, unless something else was chosen and goes on.
      const current = this.job;
      const running = this.state.jobs.find(({ ended, state }) => !ended && state !== "queued");
      if ((!current || current.ended) && running && this.following) this.select(running.id);
      this.describe();
      await pause(kStateInterval);
    }
  }

  private measureRate(): void {
    const { job } = this;
    const at = performance.now();
    if (!job || job.ended) {
      this.counted = undefined;
      this.rate = job && job.wall_s > 0 ? job.frames_complete / job.wall_s : 0;
      return;
    }
    if (this.counted?.id === job.id) this.rate = (1000 * (job.frames_complete - this.counted.frames)) / (at - this.counted.at);
    this.counted = { id: job.id, frames: job.frames_complete, at };
  }

  private select(id: string): void {
    if (id === this.selected) return;
    this.selected = id;
    ++this.turn;
    this.frames = undefined;
    this.times = undefined;
    this.received = 0;
    this.rate = 0;
    this.touched = false;
    this.grid.stage?.dispose();
    this.grid.stage = undefined;
    this.stageCard.querySelectorAll("canvas, table").forEach((element) => element.remove());
    this.setFollowing(true);
    void this.follow(id, this.turn);
  }

  /** Asks for the meshes, then for one frame after another, each newer than the last: a slow page leaves frames out. */
  private async follow(id: string, turn: number): Promise<void> {
    const path = `jobs/${encodeURIComponent(id)}`;
    const ask = async (what: string): Promise<Response | undefined> => {
      while (turn === this.turn) {
        try {
          const answer = await fetch(`${path}/${what}`);
          // 204: nothing yet, or never, where the job has ended. 404: there is no such job any more.
          if (answer.status === 200) return turn === this.turn ? answer : undefined;
          if (answer.status === 404 || answer.headers.has("Pleat-Over")) return undefined;
          if (answer.status !== 204) await pause(kStateInterval);
        } catch {
          await pause(kStateInterval);
        }
      }
      return undefined;
    };
    const meshes = await ask("meshes");
    if (!meshes) return;
    const frames = new LiveFrames(await meshes.arrayBuffer());
    for (;;) {
      const answer = await ask(`frame?after=${frames.newest}`);
      if (!answer) return;
      const buffer = await answer.arrayBuffer();
      if (turn !== this.turn) return;
      this.frames = frames;
      if (frames.add(buffer)) this.newFrame();
      // As fast as the page is drawn, at most.
      await new Promise(requestAnimationFrame);
    }
  }

  private newFrame(): void {
    const frames = this.frames!;
    const newest = frames.about(frames.count - 1);
    ++this.received;
    if (!this.times && newest.stages.length > 0) {
      this.times = new StageTimes(this.stageCard, newest.stages.map(({ name }) => name).filter((name) => !name.includes(".")));
    }
    this.times?.add(newest.stages, newest.index);
    if (!this.grid.stage) {
      this.grid.stage = new Stage(this.grid.container, byId<HTMLCanvasElement>("canvas"), frames, undefined, this.grid.panels);
      this.grid.stage.controls.addEventListener("start", () => (this.touched = true));
      this.grid.stage.resetCamera();
    } else if (!this.grid.stage.holds(frames.count - 1)) {
      this.grid.stage.remeasure();
      if (!this.touched) this.grid.stage.resetCamera();
    }
    this.slider.max = String(frames.count - 1);
    if (this.following) this.show(frames.count - 1);
    drawStrip(frames);
  }

  private show(place: number): void {
    const { frames } = this;
    if (!frames || frames.count === 0) return;
    this.place = Math.max(0, Math.min(frames.count - 1, place));
    this.slider.value = String(this.place);
    const { index, time_s } = frames.about(this.place);
    byId("frame").textContent = `Frame ${index}`;
    byId("time").textContent = `${time_s.toFixed(2)} s`;
    this.grid.stage?.setFrame(this.place);
  }

  private setFollowing(on: boolean): void {
    this.following = on;
    this.play.innerHTML = on ? kPause : kPlay;
    this.play.setAttribute("aria-label", on ? "Hold this frame" : "Follow the newest frame");
    this.play.title = this.play.getAttribute("aria-label")!;
    if (on && this.frames) this.show(this.frames.count - 1);
  }

  private key(event: KeyboardEvent): boolean {
    if (event.key === " ") {
      this.setFollowing(!this.following);
    } else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
      this.setFollowing(false);
      this.show(this.place + (event.key === "ArrowLeft" ? -1 : 1) * (event.shiftKey ? 10 : 1));
    } else if (event.key === "End") {
      this.setFollowing(true);
    } else {
      return false;
    }
    return true;
  }

  /** Everything but the frames. */
  private describe(): void {
    const { job, state } = this;
    byId("title").textContent = job ? nameOf(job) : state.jobs.length > 0 ? "Nothing is running" : "No jobs yet";
    setChips(job ? [job.detail === "network" || job.detail === "both" ? job.model : "", job.detail, job.device && `${job.device} · ${job.precision}`] : []);
    this.grid.setNote("coarse", job && job.coarse_vertices > 0 ? `${job.coarse_vertices.toLocaleString("en")} vertices` : "");
    this.grid.setNote("enhanced", job && job.fine_vertices > 0 ? `${job.fine_vertices.toLocaleString("en")} vertices` : "");
    this.listJobs();
    this.figures.replaceChildren();
    const verdict = (value: number) => (value === 0 ? "good" : "bad");
    tile(this.figures, job ? formatNumber(this.rate) : "–", "frames/s");
    tile(this.figures, job ? job.frames_complete.toLocaleString("en") : "–", job && job.frames > 0 ? `of ${job.frames.toLocaleString("en")} frames` : "frames");
    tile(this.figures, job ? job.frame_errors.toLocaleString("en") : "–", "frames failed", job && verdict(job.frame_errors));
    // Jobs sum them up at their end; until then the frames that came tell.
    const sum = (count: (frame: { penetrations: number; self_intersections: number }) => number, whole: number) => {
      let seen = 0;
      for (let i = 0; this.frames && i < this.frames.count; ++i) seen += count(this.frames.about(i));
      return Math.max(whole, seen);
    };
    const penetrations = sum((frame) => frame.penetrations, job?.penetrations ?? 0);
    const crossings = sum((frame) => frame.self_intersections, job?.self_intersections ?? 0);
    tile(this.figures, job ? penetrations.toLocaleString("en") : "–", "penetrations", job && verdict(penetrations));
    tile(this.figures, job ? crossings.toLocaleString("en") : "–", "self-inter\u00adsections", job && verdict(crossings));
    tile(this.figures, String(state.jobs.filter(({ state }) => state === "queued").length), "jobs wait");
    const lines = [
      ...(state.problem ? [state.problem] : []),
      ...(job?.error ? [job.error] : []),
      ...this.frameErrors(),
      ...(job?.warnings ?? []),
      ...[...state.notes].reverse(),
    ];
    this.messages.replaceChildren(...lines.slice(0, 40).map((line) => make("p", "", line)));
    if (lines.length === 0) this.messages.append(make("p", "none", "None."));
  }

  private frameErrors(): string[] {
    const errors: string[] = [];
    for (let i = (this.frames?.count ?? 0) - 1; i >= 0 && errors.length < 5; --i) {
      const { error } = this.frames!.about(i);
      if (error) errors.push(error);
    }
    return errors;
  }

  private listJobs(): void {
    const rows = this.state.jobs.map((job) => {
      const row = make("button", "job");
      row.setAttribute("aria-pressed", String(job.id === this.selected));
      row.title = job.id;
      row.dataset.id = job.id;
      const line = make("span", "line");
      line.append(make("b", "", nameOf(job)), make("i", job.error ? "bad" : "", job.queue_place > 0 ? `queued, ${job.queue_place}.` : job.state));
      const bar = make("span", "bar");
      const share = job.frames > 0 ? job.frames_complete / job.frames : job.ended ? 1 : 0;
      bar.style.setProperty("--share", `${100 * Math.min(1, share)}%`);
      row.append(line, bar);
      row.addEventListener("click", () => {
        this.select(job.id);
        this.describe();
      });
      return row;
    });
    const focused = (document.activeElement as HTMLElement | null)?.dataset.id;
    this.list.replaceChildren(...rows);
    rows.find((row) => row.dataset.id === focused)?.focus();
    if (rows.length === 0) this.list.append(make("p", "none", "None. `pleat run SCENE --coordinator ADDRESS` makes one."));
  }

  private publish(): void {
    const page = this;
    window.pleatLive = {
      get jobs() {
        return page.state.jobs;
      },
      get problem() {
        return page.state.problem;
      },
      get selected() {
        return page.selected;
      },
      set selected(id) {
        if (id) page.select(id);
      },
      get frame() {
        return page.frames && page.frames.count > 0 && page.grid.stage ? page.frames.about(page.place).index : -1;
      },
      get received() {
        return page.received;
      },
      get following() {
        return page.following;
      },
      set following(on) {
        page.setFollowing(on);
      },
      setCamera(azimuth, elevation, zoom) {
        page.touched = true;
        page.grid.stage?.resetCamera(azimuth, elevation, zoom);
      },
      render: () => page.grid.stage?.render(),
    };
  }
}

function nameOf(job: LiveJob): string {
  return job.live ? `Live session of ${job.owner}` : job.scene || job.id;
}

export function startLive(): void {
  new LivePage().run();
}
