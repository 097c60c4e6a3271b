// How a phone opens page Receive: a QR code, and a button that opens the server to the network.

import { ask } from "../common/api";
import { one } from "../common/dom";
import type { Notice } from "../common/notice";

interface Phone { url: string; code: string; opens: boolean }

const CLOSED = "So that a phone opens page Receive by a QR code, the server can listen to this machine's network until you close it or the server ends. " +
  "Only devices with the code have access. Open only in a network that you trust.";

export async function showPhone(notice: Notice, method: "GET" | "PUT" | "DELETE" = "GET"): Promise<void> {
  const { url, code, opens } = (await (await ask("transmit/phone", { method })).json()) as Phone;
  const [text, image, button] = [one("phone", HTMLElement), one("code", HTMLImageElement), one("open-network", HTMLButtonElement)];
  URL.revokeObjectURL(image.src);
  if (url !== "") image.src = URL.createObjectURL(new Blob([code], { type: "image/svg+xml" }));
  image.hidden = url === "";
  const live = url.startsWith("https:") ? "" : " Its live camera requires HTTPS.";
  text.textContent = url === "" ? CLOSED :
    `Scan the code with the phone and choose “Or record one now”. Both devices must share a network.${live} Everyone with the code has access to this server.`;
  button.hidden = !opens;
  button.textContent = url === "" ? "Open to the network" : "Close to the network";
  button.onclick = () => {
    button.disabled = true;
    void showPhone(notice, url === "" ? "PUT" : "DELETE").catch((error: unknown) => notice.fail(error)).finally(() => { button.disabled = false; });
  };
}
