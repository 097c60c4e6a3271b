// How a phone opens page Receive: a QR code if it can reach the server, else a sentence.

import { ask } from "../common/api";
import { make, one } from "../common/dom";

export async function showPhone(): Promise<void> {
  const { url, code } = (await (await ask("transmit/phone")).json()) as { url: string; code: string };
  const text = one("phone", HTMLElement);
  if (url === "") {
    text.append("To open page Receive on the phone, end the server by Ctrl-C and start it with ", make("code", {}, "heliograph serve --host 0.0.0.0"), ".");
    return;
  }
  const image = one("code", HTMLImageElement);
  image.src = URL.createObjectURL(new Blob([code], { type: "image/svg+xml" }));
  image.hidden = false;
  const live = url.startsWith("https:") ? "" : " Its live camera requires HTTPS.";
  text.textContent = `Scan the code with the phone and choose “Or record one now”. Both devices must share a network.${live} Everyone with the code has access to this server.`;
}
