// The page: asks for what is new, one question at a time, and shows it. It changes nothing but by the stop button.

import kinds from "panels";
import { Refused, call, fetchPart, host, pressStop } from "./call.ts";
import { ages, byId, clock, make, say } from "./dom.ts";
import type { Host } from "./host.ts";
import type { Page, Panel, Topics } from "./panel.ts";
import type { AgentState } from "./panels/agent.ts";
import type { MapPanel } from "./panels/map.ts";
import { type Pick, Picks } from "./picks.ts";
import { enlargeable, foldable, isSeen, share } from "./tabs.ts";

type Robot = { title?: string; live?: boolean; why?: string; topics?: Topics; source?: string; begin_s?: number; end_s?: number };
type Update = { view: string; now_s: number; panels: Record<string, { number: number; [name: string]: unknown }> };
type Stopped = { summary: string; is_all_well: boolean; servers: { name: string; answered: boolean; said: string; is_doubted: boolean }[]; problems: string[] };

const WAIT_MS = 1000;
const STILL_MS = 150; // of a recording nothing is new but what is sought, which does not wait for it
const AGAIN_MS = 700;
const SILENT_S = 3; // as a panel looks old
const MAP_MS = 1500; // until a map that is shown again has been answered for
const LEAST_MS = 30; // between two questions: thirty a second are more than anybody sees

// ── theme ───────────────────────────────────────────────────────────────────────────────────────────────────────────

const prefersDark = matchMedia("(prefers-color-scheme: dark)");
let pickedTheme = "";
function applyTheme(): void {
  const around = host?.context.theme;
  document.documentElement.dataset.theme = pickedTheme || (around === "dark" || around === "light" ? around : prefersDark.matches ? "dark" : "light");
  for (const panel of panels.values()) panel.repaint?.();
}

// ── panels ──────────────────────────────────────────────────────────────────────────────────────────────────────────

let view = "";
const picks = new Picks(tellPicks, host, () => { for (const panel of panels.values()) panel.mark?.(); });
const page: Page = {
  picks,
  part: (key) => fetchPart(view, key),
  shownS: () => (robot.live === false ? serverS : null),
  giveUp: (panel, why) => {
    const [name] = [...panels].find(([, one]) => one === panel) ?? [""], first = placeOf(name)[0] ?? "";
    const shown = panels.get(first);
    if (shown) shown.note = why;
    if (why && isSeen(name)) showTab(first);
  },
};
const names = Object.keys(kinds).sort((one, other) => (kinds[one]?.order ?? 0) - (kinds[other]?.order ?? 0));
const panels = new Map<string, Panel>();
for (const name of names) {
  const kind = kinds[name];
  if (!kind) continue;
  const section = make("section", { id: name, class: `panel ${kind.place}`, "aria-label": kind.title });
  document.querySelector("main")?.append(section);
  panels.set(name, kind.make(section, page));
}
/** The panels of the place where this one is, in their order. */
const placeOf = (name: string): string[] => names.filter((other) => kinds[other]?.place === kinds[name]?.place);
const tabs = new Map(names.filter((name) => placeOf(name).length > 1 && placeOf(name)[0] === name)
  .map((first) => [first, share(placeOf(first).map((name) => [name, kinds[name]?.title ?? name]))]));
const showTab = (name: string): void => tabs.get(placeOf(name)[0] ?? "")?.(name);
foldable(names.filter((name) => kinds[name]?.folds));
enlargeable(names);
const map = panels.get("map") as MapPanel; // the header says how it moves
/** What is chosen in each panel, and in the header, which shows the robot. */
const chosenIn = (name: string): string => panels.get(name)?.chosen ?? "";
let seen: Record<string, number> = {};
const failed = new Map<string, string>();
// What a panel has dropped for another choice it is sent again, also where the choice is the old one again.
document.addEventListener("change", (event) => { const panel = (event.target as Element).closest("section"); if (panel) delete seen[panel.id]; });
let serverS = 0, heardAt = 0, lost = "connecting", robot: Robot = {}, latest: AgentState = {};

const nowS = (): number => serverS + (robot.live === false ? 0 : (performance.now() - heardAt) / 1000);

function show(name: string, content: never): void {
  if (name === "robot") showRobot(content);
  else panels.get(name)?.update(content);
  if (name === "agent") latest = content;
}

function showRobot(state: Robot): void {
  robot = state;
  if (state.live === false) [ages.fresh, ages.old] = ["then", "before"];
  say(byId("title"), state.title ?? "");
  document.title = `${state.title ?? ""} · ros2-mcp`;
  for (const panel of panels.values()) panel.offer?.(state.topics ?? []);
  if (state.live === false && state.begin_s !== undefined && state.end_s !== undefined) showTime(state.begin_s, state.end_s);
}

// ── the recording's time ────────────────────────────────────────────────────────────────────────────────────────────

let atS: number | null = null, speed = 1, playing = 0;
let timeBar: { range: HTMLInputElement; told: HTMLElement; play: HTMLButtonElement } | null = null;

function showTime(begin: number, end: number): void {
  if (timeBar) return;
  const range = make("input", { type: "range", min: "0", max: String(Math.ceil((end - begin) * 20) / 20), step: "0.05", "aria-label": "Time of the recording" });
  const play = make("button", { type: "button", title: "Play (space)" }, "▶");
  const faster = make("button", { type: "button", title: "Speed" }, "1×");
  const told = make("output");
  range.value = String((atS ?? end) - begin);
  const seek = (s: number): void => { atS = begin + Math.min(Math.max(s, 0), end - begin); range.value = String(atS - begin); };
  const step = (s: number): void => { playing = 0; seek((atS ?? end) - begin + s); };
  range.addEventListener("input", () => seek(Number(range.value)));
  play.addEventListener("click", () => { if (!playing && atS !== null && atS >= end) seek(0); if (atS === null) seek(0); playing = playing ? 0 : performance.now(); });
  faster.addEventListener("click", () => { speed = speed >= 8 ? 0.5 : speed * 2; say(faster, `${speed}×`); });
  document.addEventListener("keydown", (event) => {
    if (isTyping(event) || event.target instanceof HTMLButtonElement) return;
    if (event.key === " ") { event.preventDefault(); play.click(); }
    if (event.key === "," || event.key === ".") step(event.key === "," ? -0.1 : 0.1);
  });
  setInterval(() => {
    if (playing) { const now = performance.now(); seek((atS ?? begin) - begin + ((now - playing) / 1000) * speed); playing = atS !== null && atS >= end ? 0 : now; }
    const shown = atS ?? end;
    say(told, `${(shown - begin).toFixed(1)} s of ${(end - begin).toFixed(1)} s · ${new Date(shown * 1000).toLocaleString("sv")}`);
    say(play, playing ? "❚❚" : "▶");
  }, 50);
  timeBar = { range, told, play };
  const footer = byId("time");
  footer.hidden = false;
  footer.append(play, faster, range, told);
}

// ── the header ──────────────────────────────────────────────────────────────────────────────────────────────────────

let mapSeenAt = 0;
function tell(): void {
  const state = byId("state"), moves = byId("moves");
  const why = lost || robot.why || [...failed.values()].join("; ");
  mapSeenAt = isSeen("map") ? mapSeenAt || performance.now() : 0; // hidden it is not asked for, and tells of no silence
  const hasMap = mapSeenAt > 0 && performance.now() - mapSeenAt > MAP_MS;
  const silent = robot.live !== false && hasMap && map.silentS > SILENT_S ? `SILENT for ${map.silentS.toFixed(1)} s` : "";
  const is = robot.title === undefined ? "connecting" : robot.live === false ? `recording · ${robot.source ?? ""}` : silent || "live";
  say(state, why || is);
  state.classList.toggle("bad", !!(why || silent));
  const servers = latest.servers ?? [], moved = [...new Set(servers.flatMap((server) => server.moves ?? []))];
  const isLatched = !!latest.latch, waiting = servers.reduce((sum, server) => sum + (server.waiting?.length ?? 0), 0);
  const asked = waiting ? `${waiting} request${waiting === 1 ? " needs" : "s need"} you · ` : "";
  const does = isLatched ? `LATCHED by ${latest.latch?.by} at ${clock(latest.latch?.since_s ?? 0)}` : moved.length ? `agent drives ${moved.join(", ")}` : servers.length ? "agent moves nothing" : latest.servers ? "no agent acts here" : "";
  const robotDoes = robot.live === false || !latest.servers ? "" : !hasMap ? "" : map.isOld ? "its motion is not known" : map.inMotion;
  say(moves, lost ? "" : (robot.live === false && does ? "the robot now: " : "") + asked + [does, robotDoes].filter(Boolean).join(" · "));
  moves.title = isLatched ? `${latest.latch?.reason}; an operator resets it: ros2-mcp operate reset` : "";
  const target = byId("target");
  target.hidden = robot.live !== false;
  say(target, robot.live === false ? latest.folder ?? "the robot now" : "");
  moves.classList.toggle("latched", isLatched);
  moves.classList.toggle("asked", waiting > 0);
  moves.classList.toggle("still", !isLatched && moved.length === 0 && !waiting && !robotDoes.startsWith("robot moves"));
  const at = nowS();
  for (const panel of panels.values()) panel.tick?.(at, !!lost);
}

// ── stop ────────────────────────────────────────────────────────────────────────────────────────────────────────────

const button = byId<HTMLButtonElement>("stop");
/** A verdict and why, short, so that what is looked at stays where it is; the rest is there to be opened. */
function tellStop(text: string, lines: string[], isWell: boolean): void {
  const said = byId("said");
  said.hidden = false;
  said.classList.toggle("ok", isWell);
  const close = make("button", { type: "button", class: "quiet", title: "Close (Esc)", "aria-label": "Close" }, "×");
  close.addEventListener("click", () => { said.hidden = true; });
  const rest = lines.length > 1 || isWell ? lines.slice(isWell ? 0 : 1) : [];
  said.replaceChildren(close, make("b", {}, `${clock(Date.now() / 1000)} · ${text}`), ...(isWell ? [] : lines.slice(0, 1).map((line) => make("div", {}, line))),
    ...(rest.length ? [make("details", {}, make("summary", {}, "all that was said"), make("ul", {}, ...rest.map((line) => make("li", {}, line))))] : []));
}

/** The first sentence of what is in doubt. */
function whyOf({ problems, servers }: Stopped): string {
  const why = problems[0] ?? servers.find((one) => one.is_doubted)?.said ?? servers.filter((one) => !one.answered).map((one) => `${one.name} gave no answer.`)[0] ?? "";
  return /^.*?[^.]\.(?= |$)/.exec(why.replace(/^NOT confirmed: /, ""))?.[0] ?? why;
}

async function stop(): Promise<void> {
  button.setAttribute("aria-busy", "true");
  tellStop("Stopping …", [], true);
  try {
    const stopped = await pressStop() as Stopped;
    const lines = [...stopped.problems, ...stopped.servers.map((one) => `${one.name}: ${one.answered ? one.said : `NO ANSWER. ${one.said}`}`)];
    tellStop(stopped.summary, stopped.is_all_well ? lines : [`If it still moves, use its own emergency stop. ${whyOf(stopped)}`, ...lines], stopped.is_all_well);
    latest = {}; // what moved before: the header says nothing of it until it is told anew
    delete seen.agent;
  } catch (error) {
    tellStop(`NOT STOPPED from here (${error instanceof Error ? error.message : "?"}). Use the robot's own emergency stop, or a terminal: ros2-mcp operate stop`, [], false);
  } finally {
    button.removeAttribute("aria-busy");
  }
}
button.addEventListener("click", () => void stop());

function isTyping(event: KeyboardEvent): boolean {
  return event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement || event.target instanceof HTMLInputElement;
}
document.addEventListener("keydown", (event) => {
  if (isTyping(event) || event.repeat) return;
  if (event.key === "s" || event.key === "S") void stop();
  if (event.key === "t") byId("theme").click();
  if (event.key === "Escape") byId("said").hidden = true;
});
byId("theme").addEventListener("click", () => { pickedTheme = document.documentElement.dataset.theme === "dark" ? "light" : "dark"; applyTheme(); });
prefersDark.addEventListener("change", applyTheme);

// ── asking ──────────────────────────────────────────────────────────────────────────────────────────────────────────

const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

/** Tells what is picked; what the server says of it is for the model, at its next turn where the chat takes it. */
async function tellPicks(picked: Pick[]): Promise<string[]> {
  const { picked: lines } = await call("ros2_view_ask", { view, picked }) as { picked: string[] };
  host?.tellModel(lines);
  return lines;
}

async function ask(): Promise<void> {
  while (!host?.isEnded) {
    if (document.hidden || host?.isSeen === false) { await pause(200); continue; } // the server gives the view up by itself
    const began = performance.now();
    try {
      // What the agent does stands in the header, too.
      const wanted = ["robot", ...names.filter((name) => name === "agent" || (isSeen(name) && panels.get(name)?.works !== false))];
      const asked = Object.fromEntries(wanted.map((name) => [name, chosenIn(name)]));
      const update = await call("ros2_view_frame", { view, panels: asked, seen, wait_ms: robot.live === false ? STILL_MS : WAIT_MS, at_s: atS }) as Update;
      if (update.view !== view) { view = update.view; seen = {}; picks.again(); }
      [serverS, heardAt, lost] = [update.now_s, performance.now(), ""];
      for (const [name, content] of Object.entries(update.panels)) {
        if (chosenIn(name) !== asked[name]) continue; // another topic was chosen meanwhile
        seen[name] = content.number;
        try { show(name, content as never); } catch (error) { failed.set(name, `the panel ${name} failed: ${String(error)}`); continue; }
        failed.delete(name); // and a panel that fails leaves the others as they are
      }
    } catch (error) {
      lost = error instanceof Refused ? error.message : `${host ? "the server does not answer through this chat" : "ros2-mcp view does not answer"} (${error instanceof Error ? error.message : "?"}): what is shown is old`;
      await pause(AGAIN_MS);
    }
    await pause(Math.max(0, (host?.leastMs ?? LEAST_MS) - (performance.now() - began)));
  }
  lost = `${host?.state}: what is shown is old`;
}

// ── in a chat ───────────────────────────────────────────────────────────────────────────────────────────────────────

function showIn(chat: Host): void {
  const root = document.documentElement, size = byId<HTMLButtonElement>("size");
  root.dataset.home = "chat";
  chat.onContext = () => {
    root.dataset.mode = chat.isFull ? "full" : "inline";
    size.hidden = !chat.canBeFull && !chat.isFull;
    size.setAttribute("aria-label", chat.isFull ? "Small" : "Large");
    applyTheme();
  };
  chat.onOpened = (opened) => {
    for (const [name, topic] of Object.entries(opened.panels)) {
      const panel = panels.get(name);
      if (!panel) continue;
      panel.chosen = topic;
      if (kinds[name]?.place === "values") root.dataset.values = "shown"; // beside a chat that place is hidden at first
      showTab(name);
    }
    if (opened.atS !== null) atS = opened.atS;
  };
  chat.onClosing = () => void call("ros2_view_ask", { view, closed: true }).catch(() => undefined);
  size.addEventListener("click", () => void chat.change(chat.isFull ? "inline" : "fullscreen").catch(() => undefined));
  chat.onContext();
}

async function begin(): Promise<void> {
  if (host) {
    showIn(host);
    const chat = host, told = setInterval(() => { lost = chat.state || lost; }, 200);
    await chat.start();
    clearInterval(told);
    if (chat.state) { lost = chat.state; return; }
  }
  await ask();
}

applyTheme();
setInterval(tell, 100);
void begin();
