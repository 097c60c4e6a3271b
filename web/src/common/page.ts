// What every page does: it takes the token from its address, so that links to other pages need not carry it.

import "./token";

/** Takes a file that is dropped anywhere: the browser would leave the page for it. */
export function onDrop(take: (file: File) => void): void {
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    const file = event.dataTransfer?.files[0];
    if (file !== undefined) take(file);
  });
}
