// Page Watch: a reception as it happens, and again.

import "../common/style.css";
import "./watch.css";
import "../common/page";
import { saveBundle } from "../common/api";
import { one } from "../common/dom";
import { Notice } from "../common/notice";
import { FrameView } from "./frame";
import { Link, type Source } from "./link";
import { apply, empty, type Model } from "./model";
import { Panels } from "./panels";
import { arrayName, type About, type Row } from "./rows";
import { SourceForm } from "./source";
import { Timeline, type Moment } from "./timeline";

const buttons = Object.fromEntries(["open", "stop", "pause", "step", "packet", "save", "live"].map((id) => [id, one(id, HTMLButtonElement)])) as
  Record<"open" | "stop" | "pause" | "step" | "packet" | "save" | "live", HTMLButtonElement>;
const scrub = one("scrub", HTMLInputElement);
const speed = one("speed", HTMLSelectElement);
const notice = new Notice(one("notices", HTMLElement));
const view = new FrameView();
const panels = new Panels();
const timeline = new Timeline();

let model: Model = empty();
let newest: About | null = null;
let looking: Moment | null = null; // at what was, in place of now
let running = false;
let paused = false;
let drawDue = false;
let newestMs = performance.now(); // when the newest frame came

/** Time without a frame after which it is said what may take so long. */
const LONG_MS = 3000;

function times(): number | null {
  return speed.value === "" ? null : Number(speed.value);
}

function showState(): void {
  buttons.stop.disabled = !running;
  for (const id of ["pause", "step", "packet"] as const) buttons[id].disabled = !running;
  buttons.save.disabled = model.state === null || !link.isOpen;
  buttons.pause.textContent = paused ? "Go on" : "Pause";
  scrub.disabled = timeline.moments.length < 2;
  buttons.live.disabled = looking === null;
  const at = looking?.about ?? newest;
  const count = model.source?.frames;
  const where = at === null ? "" :
    `${at.time_s.toFixed(3)} s, frame ${at.frame}${count ? ` of ${count}` : ""}${looking === null ? "" : " (recorded)"}`;
  const waiting = running && !paused && looking === null && performance.now() - newestMs > LONG_MS;
  one("where", HTMLElement).textContent = waiting ? `${where}${where ? "; " : ""}working: the first time the receiver is compiled, up to a minute` : where;
}
setInterval(showState, 1000);

function draw(): void {
  if (drawDue) return;
  drawDue = true;
  requestAnimationFrame(() => {
    drawDue = false;
    if (looking === null) panels.draw(model, newest);
    showState();
  });
}

// what is said aloud: few things, and not faster than they can be heard
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
  if (row.event === "source") notice.say(`Watching ${row.name}: ${row.width} by ${row.height} px, ${row.rate_hz.toPrecision(4)} frames/s, receiver ${row.receiver}.`);
  if (row.event === "camera") notice.say(row.text);
}

async function saved(bundle: string): Promise<void> {
  try {
    await saveBundle(bundle);
    notice.say(`Saved: 'heliograph receive failed.h5 --receiver ${model.source?.receiver ?? "auto"}' reads it again.`);
  } catch (error) {
    notice.fail(error);
  }
}

function heard(row: Row): void {
  sayRow(row);
  if (row.event === "failed" || row.event === "refused") {
    notice.fail(new Error(row.reason));
    if (row.event === "failed") ended();
  } else if (row.event === "saved") {
    void saved(row.bundle);
  } else if (row.event === "end") {
    const read = model.arrays.reduce((sum, array) => sum + array.packets, 0);
    notice.say(`The end: ${model.state?.frames ?? 0} frames, ${read} packets.`);
    ended();
  } else {
    apply(model, row); // counts of before a pause may come after it: `paused` is what was asked for here, not what they say
    timeline.row(row);
  }
  draw();
}

function ended(): void {
  running = false;
  paused = false;
  showState();
}

async function scene(about: About, picture: Blob): Promise<void> {
  newest = about;
  newestMs = performance.now();
  const last = timeline.moments.at(-1);
  if (last === undefined || last.about.frame !== about.frame) timeline.moment(about, picture);
  scrub.max = String(Math.max(timeline.moments.length - 1, 0));
  if (looking === null) {
    scrub.value = scrub.max;
    await view.draw(about, picture, model);
  }
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
  if (moment === null) scrub.value = scrub.max;
  showState();
}

const link = new Link({
  row: heard,
  scene,
  gone: (reason) => {
    if (running || reason !== "") notice.fail(new Error(reason || "the connection ended"));
    ended();
  },
});

function begin(source: Source): void {
  timeline.clear();
  model = empty();
  newest = looking = null;
  panels.forget();
  view.clear();
  running = true;
  paused = false;
  newestMs = performance.now();
  notice.say("Opening. The first time the receiver is compiled for this computer, which takes up to a minute.");
  link.open(source, times());
  draw();
}

new SourceForm(begin, (error) => notice.fail(error));
buttons.stop.onclick = () => {
  link.say({ do: "stop" });
  ended();
};
buttons.pause.onclick = () => {
  paused = !paused;
  link.say({ do: paused ? "pause" : "go" });
  if (looking !== null) void lookAt(null);
  showState();
};
for (const id of ["step", "packet"] as const) {
  buttons[id].onclick = () => {
    paused = true;
    link.say({ do: id });
    if (looking !== null) void lookAt(null);
    showState();
  };
}
buttons.save.onclick = () => link.say({ do: "save" });
buttons.live.onclick = () => void lookAt(null);
speed.onchange = () => link.say({ do: "speed", times: times() });
scrub.oninput = () => {
  const moment = timeline.moments[scrub.valueAsNumber];
  if (moment === undefined) return;
  if (running && !paused) buttons.pause.click();
  void lookAt(moment);
};
one("frame-box", HTMLElement).onkeydown = (event) => {
  const act = ({ " ": buttons.pause, ".": buttons.step, n: buttons.packet, Home: buttons.live } as Record<string, HTMLButtonElement>)[event.key];
  if (act === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  act.click();
};
view.clear();
showState();
