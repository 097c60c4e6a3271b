import "../common/style.css";
import "./receive.css";
import "../common/page";
import { ask, kindOf, save, upload } from "../common/api";
import { make, one } from "../common/dom";
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
const results = new Results();

let socket: WebSocket | null = null;
let camera: Camera | null = null;
let stream: MediaStream | null = null;
let sending: AbortController | null = null;

function asked(kind: Wish["kind"]): Wish {
  const side = one("side", HTMLSelectElement).value;
  const rate = one("rate", HTMLInputElement).value;
  return { kind, side: side === "" ? null : Number(side), rate_hz: rate === "" ? null : Number(rate) };
}

function say(text: string): void {
  if (state.textContent !== text) state.textContent = text;
}

function begin(words: string): void {
  end();
  notice.clear();
  results.clear();
  showWhy([]);
  say(words);
  stop.hidden = false;
}

/** Ends what runs; what was read stays. */
function end(): void {
  sending?.abort();
  socket?.close();
  closeCamera();
  [sending, socket] = [null, null];
  bar.hidden = stop.hidden = true;
}

function closeCamera(): void {
  camera?.stop();
  stream?.getTracks().forEach((track) => track.stop());
  [camera, stream] = [null, null];
  one("view", HTMLElement).hidden = true;
  start.textContent = "Start the camera";
}

function showWhy(lines: string[]): void {
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
    case "light":
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
      break;
    case "asking why":
      say("Nothing is read yet. Looking for the reason …");
      break;
    case "why":
      showWhy(row.lines.length > 0 ? row.lines : ["No reason was found: film longer, closer and steadier."]);
      saveButton.hidden = camera === null;
      say("Nothing is read yet.");
      break;
    case "kept":
      void keep(row.name);
      break;
    case "end":
      say(ending(row));
      break;
    default:
  }
}

function lightWords({ rate_hz: rate, side }: Row & { event: "light" }): string {
  if (rate === null && !side) return "Nothing blinks as patterns do yet: hold the camera so that it sees them.";
  const shown = [...(rate === null ? [] : [`${Number(rate.toFixed(2))} patterns a second`]), ...(side ? [`${side} × ${side} cells`] : [])];
  return `The screen shows ${shown.join(", ")}. Reading …`;
}

function ending(row: Row & { event: "end" }): string {
  const words = `${row.frames} frames, ${row.packets} packets, ${row.ok} of ${row.ok + row.failed} codewords read.`;
  if (row.ok === 0) return `The end: nothing was read. ${words}`;
  return results.count > 0 ? `The end. ${words}` : `The end: nothing came whole; film longer. ${words}`;
}

function closed(reason: string): void {
  socket = null;
  closeCamera();
  bar.hidden = stop.hidden = true;
  if (reason !== "") {
    notice.fail(reason);
    say("Ended.");
  }
}

async function readFilm(file: File): Promise<void> {
  begin("Uploading …");
  progress(0);
  sending = new AbortController();
  const name = await upload(file, kindOf(file), progress, sending.signal);
  sending = null;
  say("Uploaded. Looking for patterns …");
  progress(null);
  socket = reading({ ...asked("film"), film: name }, take, closed);
}

async function readCamera(): Promise<void> {
  if (camera !== null) {
    finish();
    return;
  }
  begin("Waiting for the camera …");
  stream = await opened(one("device", HTMLSelectElement).value);
  video.srcObject = stream;
  one("view", HTMLElement).hidden = false;
  await video.play();
  await listDevices();
  start.textContent = "Stop the camera";
  say("Looking for patterns: this takes 7 seconds.");
  const size = Math.min(Number(one("size", HTMLSelectElement).value), video.videoWidth, video.videoHeight);
  socket = reading(asked("camera"), take, closed);
  camera = new Camera(video, size, socket);
}

/** The camera's last packet is still read, and then the server ends it. */
function finish(): void {
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
    make("option", { value: "" }, "The one at the back"),
    ...found.map((one, k) => make("option", { value: one.deviceId, selected: one.deviceId === chosen }, one.label || `Camera ${k + 1}`)),
  );
}

async function keep(name: string): Promise<void> {
  const answer = await ask(`receive/kept/${name}`);
  save(await answer.blob(), "unread.mkv");
  notice.say("unread.mkv holds the last frames: 'heliograph probe unread.mkv' tells more, and 'heliograph receive unread.mkv' reads it.");
}

function showCounts(): void {
  if (camera === null) return;
  const { seen, sent, unsent } = camera.counts;
  const slow = unsent > 0 ? `; ${unsent} not sent, as the network or the server was too slow: choose a smaller picture` : "";
  one("counts", HTMLElement).textContent = `${seen} frames seen, ${sent} sent${slow}.`;
}

function chosen(input: HTMLInputElement): void {
  const file = input.files?.[0];
  if (file !== undefined) void readFilm(file).catch(failed);
}

function failed(error: unknown): void {
  end();
  if (error instanceof DOMException && error.name === "AbortError") return;
  const refused = error instanceof DOMException && error.name === "NotAllowedError";
  notice.fail(refused ? "The camera was refused: allow it for this page, or take a film." : error);
  say("Nothing yet.");
}

film.addEventListener("change", () => chosen(film));
shot.addEventListener("change", () => chosen(shot));
for (const kind of ["dragover", "dragleave", "drop"] as const) {
  drop.addEventListener(kind, (event) => {
    event.preventDefault();
    drop.classList.toggle("over", kind === "dragover");
    const file = kind === "drop" ? event.dataTransfer?.files[0] : undefined;
    if (file !== undefined) void readFilm(file).catch(failed);
  });
}
start.addEventListener("click", () => void readCamera().catch(failed));
stop.addEventListener("click", () => {
  if (camera !== null) finish();
  else {
    end();
    say("Stopped.");
  }
});
saveButton.addEventListener("click", () => {
  if (socket?.readyState === WebSocket.OPEN) socket.send("save");
});
setInterval(showCounts, 500);
