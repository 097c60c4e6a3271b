// What the pages ask of the server: JSON, uploads with progress, WebSockets.

import { token } from "./token";

/** What the server refused, in its own words. */
export class ServerError extends Error {
  constructor(message: string, readonly status: number) {
    super(message);
  }
}

function headers(): Record<string, string> {
  return token === null ? {} : { authorization: `Bearer ${token}` };
}

function reasonOf(text: string, status: number): string {
  try {
    const said: unknown = JSON.parse(text);
    if (typeof said === "object" && said !== null && "error" in said) return String(said.error);
  } catch {
    // not JSON: the status has to do
  }
  return status === 0 ? "the server has stopped: start it again and reload this page" : `the server answered ${status}`;
}

/** Asks for a path below /api and returns the answer; a ServerError says why there is none. */
export async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(new URL(`api/${path}`, location.href), { ...init, headers: { ...headers(), ...init.headers } });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new ServerError(reasonOf("", 0), 0);
  }
  if (!answer.ok) throw new ServerError(reasonOf(await answer.text(), answer.status), answer.status);
  return answer;
}

/** Asks for JSON; what is posted, if anything, is JSON too. */
export async function askJson<T>(path: string, posted?: unknown): Promise<T> {
  const init = posted === undefined ? {} : {
    method: "POST", body: JSON.stringify(posted), headers: { "content-type": "application/json" },
  };
  return (await (await ask(path, init)).json()) as T;
}

/** What a file's name ends in, without the dot; the server tells most kinds by their content anyway. */
export function kindOf(file: File): string {
  return /\.([A-Za-z0-9]{1,5})$/.exec(file.name)?.[1]?.toLowerCase() ?? "";
}

/** Uploads a film; returns the name by which the server knows it. `progress` gets the part that is sent, 0 to 1. */
export function upload(file: Blob, kind: string, progress: (part: number) => void, stop?: AbortSignal): Promise<string> {
  return new Promise((done, fail) => {
    const request = new XMLHttpRequest(); // fetch tells nothing of an upload's progress
    request.open("PUT", new URL(`api/films?kind=${encodeURIComponent(kind)}`, location.href));
    for (const [name, value] of Object.entries(headers())) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => progress(event.loaded / Math.max(event.total, 1));
    request.onload = () => {
      if (request.status === 201) done((JSON.parse(request.responseText) as { film: string }).film);
      else fail(new ServerError(reasonOf(request.responseText, request.status), request.status));
    };
    request.onerror = () => fail(new ServerError("the upload broke off: the server ended, or refused the film's size", 0));
    request.onabort = () => fail(new DOMException("stopped", "AbortError"));
    stop?.addEventListener("abort", () => request.abort());
    request.send(file);
  });
}

/** Opens a WebSocket to a path below /api. */
export function socket(path: string): WebSocket {
  const address = new URL(`api/${path}`, location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  const made = new WebSocket(address, token === null ? ["heliograph"] : ["heliograph", `token.${token}`]);
  made.binaryType = "arraybuffer";
  return made;
}

/** Fetches a film of what failed and gives it to the user. */
export async function saveBundle(name: string): Promise<void> {
  save(await (await ask(`bundles/${name}`)).blob(), "failed.h5");
}

/** Gives a file to the user, as if it were downloaded. */
export function save(data: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(data);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
