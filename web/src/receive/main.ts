import "../common/style.css";
import "./receive.css";
import { onDrop } from "../common/page";
import { kindOf, saveBundle, upload } from "../common/api";
import { bytes, make, one } from "../common/dom";
import { Notice } from "../common/notice";
import { Camera, opened } from "./camera";
import { Results } from "./results";
import { reading, type Row, type Wish } from "./rows";

const film = one("film", HTMLInputElement);
const shot = one("shot", HTMLInputElement);
const drop = one("drop", HTMLElement);
const start = one("start", HTMLButtonElement);
const stop = one("stop", HTMLButtonElement);
const saveButton = one("save", HTMLButtonElement);
const video = one("video", HTMLVideoElement);
const state = one("state", HTMLElement);
const bar = one("progress", HTMLProgressElement);
const notice = new Notice(one("notices", HTMLElement));
const overlay = one("overlay", SVGSVGElement);
const outline = one("outline", SVGPolygonElement);
const results = new Results();

let socket: WebSocket | null = null;
let camera: Camera | null = null;
let stream: MediaStream | null = null;
let sending: AbortController | null = null;
/** Film of the failed packets, offered by the server at the end; during a reception, the page requests it. */
let bundle: string | null = null;

function asked(kind: Wish["kind"]): Wish {
  const side = one("side", HTMLSelectElement).value;
  const rate = one("rate", HTMLInputElement).value;
  return { kind, side: side === "" ? null : Number(side), rate_hz: rate === "" ? null : Number(rate) };
}

function say(text: string): void {
  if (state.textContent !== text) state.textContent = text;
}

/** True after a search for patterns that failed. */
let isDark = false;

/** Number of the newest reception; rows and errors of older receptions are ignored. */
let turn = 0;

function begin(words: string): number {
  end();
  turn += 1;
  notice.clear();
  results.clear();
  showWhy([]);
  isDark = false;
  bundle = null;
  one("counts", HTMLElement).textContent = "";
  saveButton.textContent = "Save what failed";
  saveButton.hidden = true;
  say(words);
  stop.hidden = false;
  return turn;
}

/** Ends the upload, reception and camera; results stay. */
function end(): void {
  sending?.abort();
  socket?.close();
  [sending, socket] = [null, null];
  rest();
}

/** Closes the camera, and hides what belongs to a reception; a focus on its button moves to the start. */
function rest(): void {
  closeCamera();
  if (document.activeElement === stop) start.focus({ preventScroll: true });
  bar.hidden = stop.hidden = true;
}

function closeCamera(): void {
  camera?.stop();
  stream?.getTracks().forEach((track) => track.stop());
  [camera, stream] = [null, null];
  one("view", HTMLElement).hidden = true;
  start.textContent = "Start the camera";
}

function showWhy(lines: string[], title = "Why nothing was received"): void {
  one("why-title", HTMLElement).textContent = title;
  one("why", HTMLElement).hidden = lines.length === 0;
  one("why-lines", HTMLElement).replaceChildren(...lines.map((line) => make("li", {}, line.replace(/^\s*-\s*/, ""))));
}

function progress(part: number | null): void {
  bar.hidden = false;
  if (part === null) bar.removeAttribute("value");
  else bar.value = part;
}

function take(row: Row): void {
  results.take(row);
  switch (row.event) {
    case "no light":
      isDark = true;
      say("No patterns found yet: point the camera at the screen.");
      break;
    case "light":
      if (isDark) showWhy([]); // reasons from frames without patterns
      isDark = false;
      say(lightWords(row));
      break;
    case "trying":
      say(`Trying ${row.side} × ${row.side} cells …`);
      break;
    case "progress":
      if (row.of !== null) progress(row.frames / Math.max(1, row.of));
      break;
    case "took":
      camera?.took(row.frames);
      break;
    case "message":
    case "file":
      showWhy([]);
      say("Receiving …");
      overlay.classList.add("read");
      break;
    case "outline":
      outline.setAttribute("points", row.corners.join(" "));
      break;
    case "early":
      showWhy(row.lines, "Likely problem, from the first frames");
      break;
    case "asking why":
      if (results.count === 0) say("Nothing received yet. Looking for the reason …");
      break;
    case "why":
      if (results.count > 0) break;
      showWhy(row.lines.length > 0 ? row.lines : ["No reason was found. Film longer, closer and steadier."]);
      if (camera !== null) {
        saveButton.textContent = `Save what failed (${bytes(row.bytes)})`;
        saveButton.hidden = false;
      }
      say("Nothing received yet.");
      break;
    case "left":
      say(`Reading the last frames: ${row.frames} left …`);
      leftAtFirst = Math.max(leftAtFirst, row.frames);
      progress(1 - row.frames / Math.max(1, leftAtFirst));
      break;
    case "saved":
      void keep(row.bundle);
      break;
    case "bundle":
      bundle = row.bundle;
      saveButton.textContent = `Save what failed (${bytes(row.bytes)})`;
      saveButton.hidden = false;
      break;
    case "refused":
      notice.fail(row.error);
      break;
    case "end":
      say(ending(row));
      break;
    default:
  }
}

function lightWords({ rate_hz: rate, side }: Row & { event: "light" }): string {
  if (rate === null && !side) return "No patterns found yet.";
  const shown = [...(rate === null ? [] : [`${Number(rate.toFixed(2))} patterns per second`]), ...(side ? [`${side} × ${side} cells`] : [])];
  return `The screen shows ${shown.join(", ")}. Reading …`;
}

function ending(row: Row & { event: "end" }): string {
  const late = row.let_go > 0 ? ` ${row.let_go} frames were skipped, as this took too long.` : "";
  const words = `${row.frames} frames, ${row.packets} packets, ${row.ok} of ${row.ok + row.failed} codewords decoded.${late}`;
  if (row.ok === 0) return `The end: nothing was received. ${words}`;
  return results.count > 0 ? `The end. ${words}` : `The end: only part of it arrived. Film about 10 s longer. ${words}`;
}

function closed(reason: string): void {
  socket = null;
  rest();
  if (reason !== "") {
    notice.fail(reason);
    say(`Ended: ${reason.replace(/\.$/, "")}.`);
  }
}

function open(wish: Wish): WebSocket {
  const mine = turn;
  socket = reading(wish, (row) => { if (mine === turn) take(row); }, (reason) => { if (mine === turn) closed(reason); });
  return socket;
}

async function readFilm(file: File): Promise<void> {
  const mine = begin("Uploading …");
  one("results", HTMLElement).scrollIntoView({ block: "nearest" });
  progress(0);
  sending = new AbortController();
  const name = await upload(file, kindOf(file), progress, sending.signal);
  if (mine !== turn) return;
  sending = null;
  say("Uploaded. Looking for patterns …");
  progress(null);
  open({ ...asked("film"), film: name });
}

async function readCamera(): Promise<void> {
  if (camera !== null) {
    finish();
    return;
  }
  const mine = begin("Waiting for the camera …");
  const given = await opened(one("device", HTMLSelectElement).value);
  if (mine !== turn) {
    given.getTracks().forEach((track) => track.stop());
    return;
  }
  stream = given;
  video.srcObject = given;
  outline.removeAttribute("points");
  overlay.classList.remove("read");
  one("view", HTMLElement).hidden = false;
  await video.play();
  one("view", HTMLElement).scrollIntoView({ block: "nearest" });
  await listDevices();
  if (mine !== turn) return;
  start.textContent = "Stop the camera";
  say("Looking for patterns: this takes 7 seconds.");
  const size = Math.min(Number(one("size", HTMLSelectElement).value), video.videoWidth, video.videoHeight);
  camera = new Camera(video, size, open(asked("camera")));
}

/** Frames that were left to read when the camera was stopped, for the bar. */
let leftAtFirst = 0;

/** The camera's last frames are still read, as long as the server has time for them; then the server ends it. */
function finish(): void {
  leftAtFirst = 0;
  if (camera === null || socket === null) end();
  else {
    camera.stop();
    if (socket.readyState === WebSocket.OPEN) socket.send("end");
    else end();
    closeCamera();
    say("Reading the last frames …");
  }
}

async function listDevices(): Promise<void> {
  const found = (await navigator.mediaDevices.enumerateDevices()).filter((one) => one.kind === "videoinput");
  const select = one("device", HTMLSelectElement);
  const chosen = select.value;
  select.replaceChildren(
    make("option", { value: "" }, "automatic"),
    ...found.map((one, k) => make("option", { value: one.deviceId, selected: one.deviceId === chosen }, one.label || `Camera ${k + 1}`)),
  );
}

async function keep(name: string): Promise<void> {
  try {
    await saveBundle(name);
    notice.say("Saved as failed.h5, the frames of the failed packets. Drop the file on page Watch to see them, with the preset phone.");
  } catch (error) {
    notice.fail(error);
  }
}

function showCounts(): void {
  if (camera === null) return;
  const { seen, sent, unsent } = camera.counts;
  const slow = unsent > 0 ? `; ${unsent} not sent, as the network or the server was too slow: under Advanced, choose a smaller Camera picture` : "";
  one("counts", HTMLElement).textContent = `${seen} frames seen, ${sent} sent${slow}.`;
}

function chosen(input: HTMLInputElement): void {
  const file = input.files?.[0];
  if (file !== undefined) run(readFilm(file));
}

/** Lets a reading begin; `begin` was called, so that its number is the newest now. */
function run(begun: Promise<void>): void {
  const mine = turn;
  begun.catch((error: unknown) => { if (mine === turn) failed(error); });
}

const CAMERA_ERRORS: Record<string, string> = {
  NotAllowedError: "The camera was refused: allow it for this page, or upload a video.",
  NotFoundError: "This device has no camera: upload a video.",
  NotReadableError: "Another program uses the camera: close it, or upload a video.",
};

function failed(error: unknown): void {
  end();
  if (error instanceof DOMException && error.name === "AbortError") return;
  const name = error instanceof DOMException ? error.name : "";
  notice.fail(CAMERA_ERRORS[name] ?? error);
  say("Nothing yet.");
}

for (const input of [film, shot]) {
  input.addEventListener("click", () => { input.value = ""; }); // the same film may be chosen again
  input.addEventListener("change", () => chosen(input));
}
for (const kind of ["dragover", "dragleave", "drop"] as const) {
  drop.addEventListener(kind, () => {
    drop.classList.toggle("over", kind === "dragover");
  });
}
onDrop((file) => run(readFilm(file)));
start.addEventListener("click", () => run(readCamera()));
stop.addEventListener("click", () => {
  if (camera !== null) finish();
  else {
    end();
    turn += 1;
    say("Stopped.");
  }
});
saveButton.addEventListener("click", () => {
  if (bundle !== null) void keep(bundle);
  else if (socket?.readyState === WebSocket.OPEN) socket.send("save");
});
setInterval(showCounts, 500);
document.addEventListener("visibilitychange", () => {
  if (document.hidden && camera !== null) notice.say("This page was hidden, and browsers slow hidden pages down. Keep it visible, in a window of its own.");
});
