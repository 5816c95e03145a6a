// The two ways to the server. Alone in a browser: POSTs with the token, which came in the fragment of the address and
// is kept in memory only. In a chat: the host, which passes on calls of tools.

import { bytesOf } from "./dom.ts";
import { Host } from "./host.ts";

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

/** The chat around this page; null alone in a browser, where `parent` is the page itself. */
export const host = window.parent === window ? null : new Host();
const token = host ? "" : takeToken();

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

const CALL_MS = 8000, STOP_MS = 25000;

export const call = (name: string, args: unknown): Promise<unknown> =>
  host ? host.callTool(name, { asked: args }, CALL_MS) : post("/call", { name, arguments: args }, CALL_MS);
export const pressStop = (): Promise<unknown> => (host ? host.callTool("ros2_view_stop", {}, STOP_MS) : post("/stop", {}, STOP_MS));

/** A large part by its key, in as many answers as it takes. */
export async function fetchPart(view: string, key: string): Promise<Uint8Array<ArrayBuffer>> {
  const parts: Uint8Array<ArrayBuffer>[] = [];
  for (let from: unknown = 0; typeof from === "number";) {
    const part = await call("ros2_view_ask", { view, key, from }) as { bulk: unknown; next: unknown };
    parts.push(bytesOf(String(part.bulk)));
    if (typeof part.next === "number" && part.next <= from) break;
    from = part.next;
  }
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}
