// Page Watch: a reception as it happens, and again.

import "../common/style.css";
import "./watch.css";
import "../common/page";
import { hashOf, stateOf, type State } from "./address";
import { saveBundle } from "../common/api";
import { bytes, one } from "../common/dom";
import { Notice } from "../common/notice";
import { FrameView } from "./frame";
import { Link, type Source } from "./link";
import { apply, empty, type Model } from "./model";
import { drawBits, Panels } from "./panels";
import { Player, recordedRun } from "./player";
import { arrayName, type About, type Row } from "./rows";
import { SourceForm } from "./source";
import { Timeline, type Moment } from "./timeline";
import { Tour } from "./tour";

const buttons = Object.fromEntries(["stop", "pause", "step", "packet", "save", "live"].map((id) => [id, one(id, HTMLButtonElement)])) as
  Record<"stop" | "pause" | "step" | "packet" | "save" | "live", HTMLButtonElement>;
const scrub = one("scrub", HTMLInputElement);
const speed = one("speed", HTMLSelectElement);
const working = one("working", HTMLElement);
const sourceBox = one("source-box", HTMLDetailsElement);
const notice = new Notice(one("notices", HTMLElement));
const view = new FrameView();
const panels = new Panels();
const timeline = new Timeline();

let model: Model = empty();
let newest: About | null = null;
let looking: Moment | null = null; // at a past moment instead of now
let running = false;
let paused = false;
let drawDue = false;
let watched: State | null = null;
let target: number | null = null; // frame at which a restored run pauses
let player: Player | null = null; // of a recorded run in the page
let newestMs = performance.now(); // when the newest frame came

/** Time without a frame before the page shows the task of the receiver. */
const LONG_MS = 1500;

function times(): number | null {
  return speed.value === "" ? null : Number(speed.value);
}

/** Present task of the receiver; empty if frames arrive. */
function work(): string {
  if (!running || looking !== null || (paused && target === null)) return "";
  if (newest === null) return model.source === null ? "Opening the source" : "Preparing the receiver";
  if (target !== null && newest.frame < target) return `Restoring frame ${target}`;
  if (paused || performance.now() - newestMs < LONG_MS) return "";
  return timeline.marks.length === 0 ? "Preparing the receiver: up to a minute at the first run on this computer" : "Decoding";
}

function showState(): void {
  buttons.stop.disabled = !running;
  for (const id of ["step", "packet"] as const) buttons[id].disabled = !running && player === null;
  const size = model.state?.save_bytes ?? 0;
  const failed = model.state?.failed ?? 0;
  buttons.save.disabled = size === 0 || !link.isOpen;
  buttons.save.textContent = failed === 0 ? `Save the last frames${size === 0 ? "" : ` (${bytes(size)})`}` : `Save what failed (${bytes(size)})`;
  one("failed", HTMLElement).textContent = failed === 0 ? "" : `${failed} ${failed === 1 ? "packet" : "packets"} not completely decoded`;
  const name = player !== null ? (player.playing ? "Pause" : "Play") : !running ? "Play" : paused ? "Resume" : "Pause";
  buttons.pause.setAttribute("aria-label", name);
  buttons.pause.title = `${name} (Space)`;
  buttons.pause.classList.toggle("holding", name === "Pause");
  scrub.disabled = timeline.moments.length < 2;
  buttons.live.disabled = looking === null;
  const at = looking?.about ?? newest;
  const count = model.source?.frames;
  const where = at === null ? "" : `${at.time_s.toFixed(3)} s · frame ${at.frame}${count ? ` of ${count}` : ""}${looking === null || player !== null ? "" : " (recorded)"}`;
  one("where", HTMLElement).textContent = where;
  scrub.setAttribute("aria-valuetext", where || "no frame yet");
  const words = work();
  working.hidden = words === "";
  if (working.textContent !== words) working.textContent = words;
  if (watched !== null && at !== null && target === null && model.source?.live === false && watched.frame !== at.frame) {
    watched = { source: watched.source, frame: at.frame };
    history.replaceState(null, "", hashOf(watched));
  }
}
setInterval(showState, 500);

function drawTimes(): void {
  const span = timeline.span(model);
  scrub.min = String(span.from_s);
  scrub.max = String(span.to_s);
  const at = looking?.about ?? newest;
  if (at !== null) scrub.value = String(at.time_s);
  timeline.draw(span, model.source?.packet_s ?? 0);
  drawBits(timeline.marks, span, looking?.about.time_s ?? null);
}

function draw(): void {
  if (drawDue) return;
  drawDue = true;
  requestAnimationFrame(() => {
    drawDue = false;
    if (looking === null) panels.draw(model, newest);
    drawTimes();
    showState();
  });
}
new ResizeObserver(() => drawTimes()).observe(one("ticks", SVGSVGElement));

// few announcements, and not faster than they can be heard
const waiting: string[] = [];
function aloud(text: string): void {
  waiting.push(text);
  if (waiting.length > 4) waiting.shift();
}
setInterval(() => {
  const text = waiting.shift();
  if (text !== undefined) one("said", HTMLElement).textContent = text;
}, 1500);

function sayRow(row: Row): void {
  if (row.event === "found") aloud(`${arrayName(row)} found ${row.distance_m.toFixed(0)} m away`);
  if (row.event === "lost") aloud(`${arrayName(row)} lost`);
  if (row.event === "message") aloud(`message of the ${row.layer} layer: ${row.text?.slice(0, 80) ?? row.road?.kind ?? `${row.bytes} bytes`}`);
  if (row.event === "source") {
    one("source-line", HTMLElement).textContent = `${row.name} · ${row.width} × ${row.height} px · ${row.rate_hz.toPrecision(4)} frames/s · receiver ${row.receiver}`;
  }
  if (row.event === "camera") notice.say(row.text);
}

async function saved(bundle: string): Promise<void> {
  try {
    await saveBundle(bundle);
    notice.say(`Saved as failed.h5. Drop the file on this page to decode it again.`);
  } catch (error) {
    notice.fail(error);
  }
}

function heard(row: Row): void {
  sayRow(row);
  if (row.event === "failed" || row.event === "refused") {
    notice.fail(new Error(row.reason));
    if (model.source === null) one("source-line", HTMLElement).textContent = "Not opened";
    if (row.event === "failed") ended();
  } else if (row.event === "saved") {
    void saved(row.bundle);
  } else if (row.event === "end" && player === null) {
    const read = model.arrays.reduce((sum, array) => sum + array.packets, 0);
    notice.say(`End: ${model.state?.frames ?? 0} frames, ${read} packets.`);
    ended();
  } else {
    apply(model, row); // counts of before a pause may come after it: `paused` is the command of this page
    timeline.row(row);
  }
  draw();
}

function ended(): void {
  running = paused = false;
  target = null;
  showState();
}

async function scene(about: About, picture: Blob): Promise<void> {
  newest = about;
  newestMs = performance.now();
  if (target !== null && about.frame >= target) target = null;
  const last = timeline.moments.at(-1);
  if (last === undefined || last.about.frame !== about.frame) timeline.moment(about, picture);
  if (looking === null) await view.draw(about, picture, model);
  draw();
}

async function lookAt(moment: Moment | null): Promise<void> {
  looking = moment;
  panels.forget();
  const shown = moment ?? timeline.moments.at(-1);
  if (shown !== undefined) {
    const then = moment === null ? model : timeline.modelAt(moment);
    await view.draw(shown.about, shown.picture, then);
    panels.draw(then, shown.about);
  }
  drawTimes();
  showState();
}

function lookBack(moment: Moment | undefined): void {
  if (moment === undefined) return;
  if (player !== null ? player.playing : running && !paused) buttons.pause.click();
  void lookAt(moment);
}

const link = new Link({
  row: heard,
  scene,
  gone: (reason) => {
    if (running || reason !== "") notice.fail(new Error(reason || "the server closed the connection"));
    ended();
  },
});

function begin(state: State): void {
  watched = state;
  target = state.frame;
  timeline.clear();
  model = empty();
  newest = looking = null;
  panels.forget();
  view.clear();
  running = true;
  paused = target !== null;
  newestMs = performance.now();
  notice.clear();
  one("source-line", HTMLElement).textContent = "Opening";
  sourceBox.open = false;
  link.open(state.source, times(), target);
  draw();
}

/** Starts a source that the user chose, as a new entry of the history. */
function choose(source: Source): void {
  const state = { source, frame: null };
  history.pushState(null, "", hashOf(state));
  begin(state);
}

function restore(): boolean {
  const state = stateOf(location.hash);
  if (state === null) return false;
  form?.show(state.source);
  begin(state);
  return true;
}

function fail(error: unknown): void {
  notice.fail(error);
  sourceBox.open = true;
}

const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
const run = recordedRun();
const form = run !== null ? null : new SourceForm(choose, fail, (recorded) => {
  if (restore()) return;
  if (recorded && !calm) begin({ source: { kind: "named", number: 0 }, frame: null });
  else sourceBox.open = matchMedia("(min-width: 60rem)").matches;
});
addEventListener("popstate", () => {
  if (restore()) return;
  link.close();
  watched = null;
  ended();
});

buttons.stop.onclick = () => {
  link.say({ do: "stop" });
  ended();
};
buttons.pause.onclick = () => {
  if (player !== null) return player.toggle();
  if (!running) {
    if (watched === null) form?.start();
    else begin({ source: watched.source, frame: null });
    return;
  }
  paused = !paused;
  target = null;
  link.say({ do: paused ? "pause" : "go" });
  if (looking !== null) void lookAt(null);
  showState();
};
for (const id of ["step", "packet"] as const) {
  buttons[id].onclick = () => {
    if (player !== null) return id === "step" ? player.step(1) : player.packet(model.source?.packet_s ?? 0);
    paused = true;
    target = null;
    link.say({ do: id });
    if (looking !== null) void lookAt(null);
    showState();
  };
}
buttons.save.onclick = () => link.say({ do: "save" });
buttons.live.onclick = () => void lookAt(null);
speed.onchange = () => {
  link.say({ do: "speed", times: times() });
  player?.anchor();
};
scrub.oninput = () => lookBack(timeline.nearest(scrub.valueAsNumber));
scrub.onkeydown = (event) => {
  const places = ({ ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 } as Record<string, number>)[event.key];
  if (places === undefined) return;
  event.preventDefault(); // a step of the slider may be shorter than the time between moments
  lookBack(timeline.after(looking, places));
};
one("frame-box", HTMLElement).onkeydown = (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const act = ({ " ": buttons.pause, ".": buttons.step, n: buttons.packet, Home: buttons.live } as Record<string, HTMLButtonElement>)[event.key];
  if (act === undefined && !view.takesKey(event.key)) return;
  event.preventDefault();
  act?.click();
};
// one open help at a time; Escape closes it
document.addEventListener("click", (event) => {
  for (const help of document.querySelectorAll<HTMLDetailsElement>("details.help[open]")) if (!help.contains(event.target as Node)) help.open = false;
});
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  const help = document.querySelector<HTMLDetailsElement>("details.help[open]");
  if (help === null) return;
  help.open = false;
  help.querySelector("summary")?.focus();
});
view.clear();
if (run !== null) {
  document.body.classList.add("replay");
  speed.value = "1";
  player = new Player(run, {
    row: heard,
    keep: (about, picture) => timeline.moment(about, picture),
    lookAt,
    looking: () => looking,
    changed: showState,
  }, timeline, () => times() ?? 1);
  new Tour(timeline, lookBack);
}
showState();
