// The token of the server. The address that was printed has it behind #, which is never sent; the tab keeps it.

const KEY = "heliograph-token";

function taken(): string | null {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given !== null) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, "", location.pathname + location.search);
  }
  return sessionStorage.getItem(KEY);
}

/** The token, or null where the server asks for none. */
export const token = taken();

/** An address of one of the pages for another tab or machine, with the token. */
export function addressOf(page: string): string {
  return new URL(page, location.href).href + (token === null ? "" : `#token=${token}`);
}
