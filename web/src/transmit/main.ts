import "../common/style.css";
import "./transmit.css";
import { onDrop } from "../common/page";
import { ask, save } from "../common/api";
import { bytes, make, one } from "../common/dom";
import { Notice } from "../common/notice";
import { drawChart } from "./chart";
import { Packets, type Facts } from "./packets";
import { showPhone } from "./phone";
import { drawPattern, MARGIN, Player, type Light } from "./player";
import { divisors, measured } from "./refresh";

const form = one("form", HTMLFormElement);
const text = one("text", HTMLTextAreaElement);
const file = one("file", HTMLInputElement);
const side = one("side", HTMLSelectElement);
const rate = one("rate", HTMLSelectElement);
const single = one("single", HTMLInputElement);
const gamma = one("gamma", HTMLInputElement);
const brightness = one("brightness", HTMLInputElement);
const screenPart = one("screen", HTMLElement);
const array = one("array", HTMLCanvasElement);
const chart = one("chart", HTMLCanvasElement);
const sendButton = one("send", HTMLButtonElement);
const pauseButton = one("pause", HTMLButtonElement);
const fullButton = one("full", HTMLButtonElement);
const said = one("said", HTMLElement);
const warning = one("warning", HTMLDialogElement);
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
const notice = new Notice(one("notices", HTMLElement));

/** Rate that is chosen first: each pattern is then in three frames of a phone's 30 a second. */
const FIRST_HZ = 10;

/** Rate at which a cell flashes once a second at most; WCAG 2.3.1 allows three flashes. */
const SLOW_HZ = 2;

/** Largest file in bytes that the server takes. */
const MAX_BYTES = 256 << 10;

/** Pause in ms of typing before a new preview: at most two changes a second. */
const PREVIEW_MS = 500;

/** Time in ms that the instruction covers the full screen. */
const INSTRUCTION_MS = 3000;

/** Length of a video that is saved in s, at least. */
const FILM_S = 30;

let player: Player | null = null;
let facts: Facts | null = null;
let packets: Packets | null = null;
let refresh = 60;
let awake: WakeLockSentinel | null = null;
let consented = false;
let leavingFullScreen = false;
let previewTimer = 0;
let instructionTimer = 0;
let previews = 0;

function light(): Light {
  return { gamma: Number(gamma.value), brightness: Number(brightness.value) / 100 };
}

function show(label: string, value: string): HTMLTableRowElement {
  return make("tr", {}, make("th", { scope: "row" }, label), make("td", {}, value));
}

function seconds(count: number): string {
  return count < 90 ? `${count.toFixed(count < 10 ? 1 : 0)} s` : `${(count / 60).toFixed(1)} min`;
}

function showFacts(): void {
  const rows: HTMLElement[] = [];
  const display = [show("Display", `${refresh.toFixed(refresh % 1 ? 2 : 0)} refreshes per second`)];
  if (facts !== null) {
    rows.push(
      show("Film for", `${filmTime(facts)} or more`),
      show("Sent", `${bytes(facts.bytes)} ${facts.as_file ? "as a file: later packets replace missed ones" : "as a message"}`),
      show("Payload", `${payload(facts)}; a packet of ${facts.packet_bytes} bytes takes ${seconds(facts.packet_s)}`),
    );
  }
  if (player !== null && facts !== null) {
    const { skipped, refreshes, lost } = player;
    const part = refreshes > 0 ? (100 * skipped) / refreshes : 0;
    display.push(show("Refreshes skipped", `${skipped} (${part.toFixed(part < 10 ? 1 : 0)} %)`));
    const row = show("Patterns never shown", String(lost));
    row.setAttribute("data-lost", String(lost));
    (lost > 0 ? rows : display).push(row);
  }
  one("facts", HTMLElement).replaceChildren(...rows);
  one("display", HTMLElement).replaceChildren(...display);
  showTurn();
  if (packets?.failed) notice.fail(packets.failed);
  else showSkipped();
}

function filmTime(sent: Facts): string {
  const least = Math.ceil(1.25 * sent.seconds + sent.packet_s);
  return least < 90 ? `${least} s` : seconds(least);
}

function payload(sent: Facts): string {
  return `${(sent.bits_per_s / 8).toFixed(sent.bits_per_s < 80 ? 1 : 0)} bytes per second`;
}

/** Shows which packet is on the screen. */
function showTurn(): void {
  const isPlaying = player !== null && player.playing && facts !== null;
  one("turn", HTMLElement).hidden = !isPlaying;
  if (player === null || facts === null || !isPlaying) return;
  const at = player.pattern / facts.packet_patterns;
  const number = Math.floor(at);
  const words = `Packet ${(number % facts.packets) + 1} of ${facts.packets}${number >= facts.packets ? ", repeated" : ""}`;
  one("turn-said", HTMLElement).textContent = words;
  one("corner", HTMLElement).textContent = words;
  one("turn-bar", HTMLProgressElement).value = (at % facts.packets) / facts.packets;
}

/** Shows a still pattern and the film time of the content; hides both if the content is invalid. */
async function preview(): Promise<void> {
  const mine = ++previews;
  if (player?.playing) return;
  let found: (Facts & { pattern: number[] }) | null = null;
  try {
    const { data, name } = await content();
    const answer = await ask(`transmit?${query(name)}&is_preview=true`, { method: "POST", body: data });
    found = (await answer.json()) as Facts & { pattern: number[] };
  } catch {
    // Send says why
  }
  if (mine !== previews || player?.playing) return;
  one("preview", HTMLElement).hidden = found === null;
  one("estimate", HTMLElement).textContent = found === null ? "" : estimate(found);
  one("single-said", HTMLElement).textContent = found === null ? "" : payload(found);
  if (found === null) return;
  const canvas = one("pattern", HTMLCanvasElement);
  const cells = found.side + 2 * MARGIN;
  canvas.width = canvas.height = cells * Math.floor(480 / cells);
  drawPattern(canvas, found.pattern, found.side, light());
}

function estimate(found: Facts): string {
  return `${bytes(found.bytes)} in ${found.packets} ${found.packets === 1 ? "packet" : "packets"}, ${payload(found)}: film for ${filmTime(found)}.`;
}

function previewSoon(): void {
  clearTimeout(previewTimer);
  previewTimer = setTimeout(() => void preview(), PREVIEW_MS);
}

/** States skipped patterns and the remedy; also on the full screen, which hides the notice. */
function showSkipped(): void {
  if (player === null || facts === null || !player.playing || player.lost < 3) return;
  const sent = facts.rate_hz;
  const slower = [...rate.options].filter((option) => refresh / Number(option.value) < 0.99 * sent).at(-1);
  const remedy = `Choose a lower rate${slower === undefined ? "" : `: ${slower.text} patterns per second`}`;
  notice.say(`This display skips refreshes: ${player.lost} patterns were never shown. ${remedy}. Close other programs, and keep this page visible in a window of its own.`);
  one("corner", HTMLElement).append(`. ${player.lost} patterns were never shown: press Esc. ${remedy}.`);
}

function advise(): void {
  const hz = refresh / Number(rate.value);
  const film = hz <= 16 ? "30" : hz <= 31 ? "60" : "240";
  const least = hz <= 3 ? "Slow: for remote desktops and few flashes. " : "";
  one("advice", HTMLElement).textContent =
    `${least}Film at ${film} frames per second${film === "30" ? ", the default of phones" : ""}.`;
}

async function content(): Promise<{ data: Blob; name: string | null }> {
  if (form.elements.namedItem("kind") instanceof RadioNodeList && (form.elements.namedItem("kind") as RadioNodeList).value === "text") {
    if (text.value === "") throw new Error("The text is empty: write a text, or choose a file.");
    return { data: new Blob([text.value]), name: null };
  }
  const chosen = file.files?.[0];
  if (chosen === undefined) throw new Error("Choose a file first.");
  if (chosen.size === 0) throw new Error(`${chosen.name} is empty: choose another file.`);
  if (chosen.size > MAX_BYTES) throw new Error(`${chosen.name} has ${bytes(chosen.size)}; a screen sends at most ${MAX_BYTES >> 10} kB.`);
  return { data: chosen, name: chosen.name };
}

/** Refreshes per pattern whose rate is nearest to one. */
function refreshesFor(hz: number): number {
  const counts = divisors(refresh);
  return counts.reduce((best, n) => (Math.abs(refresh / n - hz) < Math.abs(refresh / best - hz) ? n : best));
}

/** A flash is a pair of changes, from dark to light and back: two patterns at least, with inverses and without. */
function flashes(lasts: number): string {
  return (refresh / lasts / 2).toFixed(refresh / lasts < 4 ? 1 : 0).replace(/\.0$/, "");
}

/** Asks before the first transmission, and before each if the system asks for reduced motion. */
async function mayFlash(): Promise<boolean> {
  if (consented && !reducedMotion.matches) return true;
  const slow = refreshesFor(SLOW_HZ);
  one("flashes", HTMLElement).textContent = flashes(Number(rate.value));
  one("slow-flashes", HTMLElement).textContent = `${flashes(slow)} per second`;
  warning.returnValue = "";
  warning.showModal();
  await new Promise((closed) => { warning.addEventListener("close", closed, { once: true }); });
  const answer = warning.returnValue; // neither if the dialog was closed by Esc
  if (answer !== "start" && answer !== "slow") return false;
  if (answer === "slow") {
    rate.value = String(slow);
    advise();
  }
  consented = answer === "start"; // a faster rate after a slow one asks again
  return true;
}

function query(name: string | null): URLSearchParams {
  return new URLSearchParams({
    side: side.value, rate_hz: String(refresh / Number(rate.value)), inverses: String(!single.checked),
    ...(name === null ? {} : { name }),
  });
}

async function send(): Promise<void> {
  notice.clear();
  const { data, name } = await content();
  if (!(await mayFlash())) return;
  const lasts = Number(rate.value);
  const answer = await ask(`transmit?${query(name)}`, { method: "POST", body: data });
  facts = (await answer.json()) as Facts;
  one("estimate", HTMLElement).textContent = estimate(facts); // the dialog may have changed the rate
  one("single-said", HTMLElement).textContent = payload(facts);
  packets = new Packets(facts);
  await packets.begin();
  player ??= new Player(array, 1000 / refresh, lasts, light());
  player.onChange = showFacts;
  one("preview", HTMLElement).hidden = true;
  player.play(packets, lasts);
  player.setLight(light());
  player.fit();
  one("film", HTMLButtonElement).disabled = false;
  enableControls(true);
  array.setAttribute("aria-label", `Patterns of ${facts.side} × ${facts.side} cells, ${facts.rate_hz.toFixed(1)} a second`);
  said.textContent = "Sending.";
  sendButton.textContent = "Send";
  showPaused();
  showFacts();
  await stayAwake();
}

function enableControls(enabled: boolean): void {
  for (const id of ["pause", "full", "again"]) one(id, HTMLButtonElement).disabled = !enabled;
}

/** Shows a dark screen at once, and leaves full screen. */
function stop(): void {
  if (player === null) return;
  player.stop();
  if (document.activeElement?.closest(".controls")) sendButton.focus({ preventScroll: true });
  enableControls(false);
  sendButton.textContent = "Send";
  said.textContent = "Stopped.";
  array.setAttribute("aria-label", "Patterns: stopped");
  if (screenPart.classList.contains("fills")) {
    screenPart.classList.remove("fills");
    keepFocus();
  }
  showInstruction();
  showTurn();
  previewSoon();
  if (document.fullscreenElement !== null) void document.exitFullscreen();
  void awake?.release();
}

async function stayAwake(): Promise<void> {
  try {
    awake ??= await navigator.wakeLock.request("screen");
    awake.onrelease = () => { awake = null; };
  } catch {
    // not offered, or not now: the display may go dark by itself
  }
}

function showPaused(): void {
  pauseButton.textContent = player?.paused ? "Resume" : "Pause";
}

function togglePause(): void {
  if (player === null) return;
  player.pause(!player.paused);
  said.textContent = player.paused ? "Paused." : "Sending.";
  showPaused();
}

function isFull(): boolean {
  return document.fullscreenElement !== null || screenPart.classList.contains("fills");
}

/** Keeps the focus on the full screen, whose controls show while they have it; returns it to the button at the end. */
function keepFocus(): void {
  for (let part: HTMLElement = screenPart; part !== document.body; part = part.parentElement!) {
    for (const other of part.parentElement!.children) if (other !== part && other instanceof HTMLElement) other.inert = isFull();
  }
  fullButton.textContent = isFull() ? "Leave full screen" : "Full screen";
  if (isFull()) screenPart.focus();
  else (player?.playing ? fullButton : sendButton).focus({ preventScroll: true });
}

async function toggleFull(): Promise<void> {
  if (screenPart.classList.contains("fills")) {
    screenPart.classList.remove("fills");
    showFull();
  } else if (document.fullscreenElement === null) {
    leavingFullScreen = false;
    try {
      await screenPart.requestFullscreen({ navigationUI: "hide" });
    } catch {
      screenPart.classList.add("fills"); // phones of one maker have no full screen for pages
      showFull();
    }
  } else {
    leavingFullScreen = true;
    await document.exitFullscreen();
  }
  player?.fit();
}

function showFull(): void {
  keepFocus();
  showInstruction();
}

/** Covers the full screen with the instruction for some seconds; removes it outside full screen. */
function showInstruction(): void {
  const instruction = one("instruction", HTMLElement);
  clearTimeout(instructionTimer);
  instruction.hidden = !isFull() || facts === null;
  if (facts === null || !isFull()) return;
  instruction.textContent = `Film this screen with your phone, held still, for ${filmTime(facts)}, or point a webcam at it: page Receive, “Start the camera”. Esc stops and returns to the page.`;
  instructionTimer = setTimeout(() => { instruction.hidden = true; }, INSTRUCTION_MS);
}

/** Esc leaves the browser's full screen without a key event, and stops the patterns too. */
function fullScreenChanged(): void {
  // the change of entering may be reported after the key to leave
  if (document.fullscreenElement === null && !leavingFullScreen) stop();
  showFull();
  player?.fit();
}

function typed(event: KeyboardEvent): void {
  const there = event.target;
  const typing = there instanceof HTMLTextAreaElement || there instanceof HTMLInputElement || there instanceof HTMLSelectElement;
  if (event.ctrlKey || event.metaKey || event.altKey || player === null) return;
  if (event.key === "Escape") stop();
  if (typing || (event.key === " " && there instanceof HTMLButtonElement)) return;
  if (event.key === " ") {
    event.preventDefault();
    togglePause();
  } else if (event.key === "f" || event.key === "F") {
    void toggleFull();
  }
}

async function saveFilm(): Promise<void> {
  if (facts === null) return;
  notice.say("The video is being made …");
  const length = Math.min(600, Math.max(FILM_S, 1.5 * facts.seconds));
  const answer = await ask(`transmit/${facts.sending}/film?seconds=${length}&gamma=${gamma.value}`);
  save(await answer.blob(), "patterns.mp4");
  notice.say(`Play patterns.mp4 (${seconds(length)}) in a loop, full screen, on any display, and film it. The video flashes like this page.`);
}

function lit(): void {
  one("gamma-said", HTMLElement).textContent = Number(gamma.value).toFixed(2);
  one("brightness-said", HTMLElement).textContent = `${brightness.value} %`;
  drawChart(chart, Number(gamma.value));
  player?.setLight(light());
}

/** Shows that the patterns are not yet those of the form. */
function markChanged(): void {
  if (player?.playing) sendButton.textContent = "Send changes";
  else previewSoon();
}

function takeFile(dropped: File): void {
  const files = new DataTransfer();
  files.items.add(dropped);
  file.files = files.files;
  one("kind-file", HTMLInputElement).checked = true;
  chooseKind();
  markChanged();
}

function chooseKind(): void {
  const isText = (form.elements.namedItem("kind") as RadioNodeList).value === "text";
  one("text-part", HTMLElement).hidden = !isText;
  one("file-part", HTMLElement).hidden = isText;
}

async function prepare(): Promise<void> {
  refresh = await measured();
  const first = refreshesFor(reducedMotion.matches ? SLOW_HZ : FIRST_HZ);
  rate.replaceChildren(...divisors(refresh).map((n) => {
    const hz = refresh / n;
    return make("option", { value: n, selected: n === first }, `${hz.toFixed(Math.abs(hz - Math.round(hz)) > 0.005 ? 1 : 0)}`);
  }));
  advise();
  showFacts();
  await preview();
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  send().catch((error: unknown) => notice.fail(error));
});
form.addEventListener("change", chooseKind);
form.addEventListener("input", markChanged);
single.addEventListener("input", markChanged);
onDrop(takeFile);
rate.addEventListener("change", advise);
gamma.addEventListener("input", lit);
brightness.addEventListener("input", lit);
pauseButton.addEventListener("click", togglePause);
fullButton.addEventListener("click", () => void toggleFull());
one("again", HTMLButtonElement).addEventListener("click", () => { player?.restart(); showPaused(); });
one("film", HTMLButtonElement).addEventListener("click", () => void saveFilm().catch((error: unknown) => notice.fail(error)));
one("stage", HTMLElement).addEventListener("dblclick", () => void toggleFull());
document.addEventListener("keydown", typed);
document.addEventListener("fullscreenchange", fullScreenChanged);
document.addEventListener("visibilitychange", () => {
  if (document.visibilityState === "visible" && player !== null) void stayAwake();
});
new ResizeObserver(() => player?.fit()).observe(one("stage", HTMLElement));
setInterval(showFacts, 1000);
lit();
chooseKind();
void prepare();
showPhone(notice).catch((error: unknown) => notice.fail(error));
