// The way to the server: POSTs with the token, which came in the fragment of the address and is kept in memory only.

const KEY = "ros2-mcp-token";

function takeToken(): string {
  const given = location.hash.slice(1);
  if (given) {
    history.replaceState(null, "", location.pathname); // out of the address, of bookmarks and of screenshots
    try { sessionStorage.setItem(KEY, given); } catch { /* then a reload asks for the address again */ }
    return given;
  }
  try { return sessionStorage.getItem(KEY) ?? ""; } catch { return ""; }
}

const token = takeToken();

export class Refused extends Error {}

async function post(path: string, body: unknown, patienceMs: number): Promise<unknown> {
  const answer = await fetch(path, {
    method: "POST", body: JSON.stringify(body), cache: "no-store", credentials: "omit", redirect: "error",
    headers: { "content-type": "application/json", "x-ros2-mcp-token": token },
    signal: AbortSignal.timeout(patienceMs),
  });
  if (answer.status === 401) throw new Refused("Open the address that ros2-mcp view has printed: this page has no token, or an old one.");
  const isJson = answer.headers.get("content-type")?.startsWith("application/json");
  const value: unknown = isJson ? await answer.json() : { error: await answer.text() };
  if (!answer.ok) throw new Error(String((value as { error?: unknown }).error ?? answer.status));
  return value;
}

export const call = (name: string, args: unknown): Promise<unknown> => post("/call", { name, arguments: args }, 8000);
export const pressStop = (): Promise<unknown> => post("/stop", {}, 25000);
