// The agent: what it does now, what waits for a person, what became of the rest.

import { Frame, clock, make, say } from "./dom.ts";

type Waiting = { id: string; age_s: number; left_s: number; summary: string[] };
type Job = { id: string; kind: string; for_s: number; at_most_s: number | null; doing: string };
type Server = { name: string; answers: boolean; why?: string; mode?: string; moves: string[]; jobs?: Job[]; waiting?: Waiting[]; grants?: string[]; audit_failed?: string };
type Act = { seq: number | null; time: string; kind: string; who: string; tool?: string; verb?: string; name?: string; type?: string; by?: string; reason?: string; outcome?: string; now?: string; approval?: string; rate_hz?: number; duration_s?: number; program?: string; value?: unknown };
export type AgentState = { servers?: Server[]; latch?: { by: string; reason: string; since_s: number } | null; acts?: Act[]; folder?: string; why?: string; origin?: string };

const JOBS: Record<string, string> = { recording: "records", program: "runs a program", cancel_when: "watches a condition" };
const VERBS: Record<string, string> = { // of policies
  publish: "publish", relay: "relay", play: "play", record: "record", call: "call", set: "set parameters of", transition: "change the state of", goal: "send a goal to", cancel: "cancel goals of",
};

/** Of what has a word of ours; `constructor` and such are names like others. */
const word = (words: Record<string, string>, name: string): string | undefined => (Object.hasOwn(words, name) ? words[name] : undefined);

export class AgentPanel {
  private readonly frame: Frame;
  private readonly waits = make("div");
  private readonly jobs = make("ol", { class: "rows" });
  private readonly origin = make("p", { class: "origin" });
  private readonly rows = make("ol", { class: "rows" });
  private readonly none = make("p", { class: "empty" });

  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Agent", false);
    this.frame.body.append(this.waits, this.jobs, this.origin, this.rows, this.none);
  }

  /** `shownS` is the time that is shown of a recording, Unix time in s. */
  update(state: AgentState, shownS: number | null = null): void {
    this.frame.tell("");
    const servers = state.servers ?? [];
    const waiting = servers.flatMap((server) => server.waiting ?? []);
    this.waits.replaceChildren(...waiting.map((one) => make(
      "div", { class: "waits" }, make("div", {}, make("b", {}, `${one.id} waits for a person`), ` · asked ${one.age_s} s ago, ${one.left_s} s left`),
      ...one.summary.map((line) => make("div", {}, line)), make("small", {}, "Answer it in a terminal: ros2-mcp operate"))));
    this.jobs.replaceChildren(...servers.flatMap((server) => server.jobs ?? []).map((job) => make("li", { class: "running" },
      make("time", {}, `${shownS === null ? "" : "now, "}${job.for_s} s`), make("span", { class: "what" }, make("b", {}, word(JOBS, job.kind) ?? job.kind), make("small", {}, ` ${[job.doing, job.id].filter(Boolean).join(" · ")}`)),
      make("span", { class: "end" }, job.at_most_s === null ? "under way" : `of ${job.at_most_s} s`))));
    say(this.origin, state.origin ? `${state.origin}:` : "");
    this.origin.hidden = !state.origin;
    const acts = [...(state.acts ?? [])].reverse(), nowMs = shownS === null ? Date.now() : shownS * 1000;
    const atEnd = this.frame.body.scrollTop;
    this.rows.replaceChildren(...acts.map((act) => row(act, nowMs)));
    this.frame.body.scrollTop = atEnd < 40 ? 0 : atEnd;
    this.none.hidden = acts.length > 0;
    this.none.textContent = state.origin ? "nothing was done until then." : servers.length ? "Nothing was done yet." : `No server acts on ${state.folder ?? "this robot"} from this machine.`;
    const modes = [...new Set(servers.map((server) => server.mode).filter(Boolean))].join(", ");
    const silent = servers.filter((server) => !server.answers).length;
    const told = `${shownS === null ? "" : "now: "}${servers.length} server${servers.length === 1 ? "" : "s"}${silent ? `, ${silent} NOT answering` : ""}${modes ? ` · ${modes}` : ""}`;
    this.frame.tellAge(told, silent > 0);
    const failed = servers.map((server) => server.audit_failed).filter(Boolean).map((text) => `The audit cannot be written: ${text}.`);
    const grants = servers.flatMap((server) => server.grants ?? []).map((text) => `Granted: ${text}`);
    this.frame.tellFoot([state.why ?? "", ...failed, ...grants].filter(Boolean).map((text) => make("div", { class: "warn" }, text)));
  }
}

/** An act is under way while its outcome is not written; one whose time is long over has lost its server. */
function isRunning(act: Act, nowMs: number): boolean {
  if (act.kind !== "act" || act.outcome) return false;
  const ends = new Date(act.time).getTime() + ((act.duration_s ?? 60) + 5) * 1000;
  return nowMs < ends;
}

function row(act: Act, nowMs: number): HTMLElement {
  const isAct = act.kind === "act" || act.kind.startsWith("refused") || act.kind === "waits";
  const does = isAct ? word(VERBS, act.verb ?? "") ?? act.verb ?? act.tool ?? act.kind : act.kind;
  const verb = act.kind === "act" ? inThird(does) : act.kind === "waits" ? `asked to ${does}` : act.kind.startsWith("refused") && act.verb ? `tried to ${does}` : does;
  const often = [act.rate_hz ? `${act.rate_hz} Hz` : "", act.duration_s ? `for ${act.duration_s} s` : ""].filter(Boolean).join(" ");
  const value = brief(act.value);
  const running = isRunning(act, nowMs);
  const end = running ? "under way" : act.kind.startsWith("refused") ? `refused` : act.outcome || (act.kind === "waits" ? "waits" : act.kind === "act" && act.seq !== null ? "no outcome" : "");
  const tone = act.kind.startsWith("refused") || ["latched", "stop"].includes(act.kind) || end.startsWith("failed") || end.startsWith("denied") ? "bad" : ["waits", "no outcome"].includes(end) || end.startsWith("stopped") ? "warn" : "";
  const told = end === "done" && act.verb === "record" ? "begun" : end; // which goes on, among the jobs
  return make("li", { class: `${tone}${running ? " running" : ""}`.trim() || undefined, title: [act.tool, act.reason].filter(Boolean).join(": ") },
    make("time", {}, clock(act.time)),
    make("span", { class: "what" }, make("b", {}, verb), act.name ? " " : "", act.name ? make("code", {}, act.name) : "",
      make("small", {}, ` ${[often, value, act.approval ?? "", act.reason ?? "", act.by ? `by ${act.by}` : "", act.now ?? ""].filter(Boolean).join(" · ")}`)),
    make("span", { class: "end", title: told }, told));
}

/** "publish" → "publishes". */
const inThird = (does: string): string => does.replace(/^[a-z]+/, (first) => `${first}${first.endsWith("sh") ? "es" : "s"}`);

/** The values that are not zero, in one line. */
function brief(value: unknown): string {
  const leaves: string[] = [];
  const walk = (at: unknown, path: string, depth: number): void => {
    if (leaves.length > 5 || depth > 5) return;
    if (Array.isArray(at)) { if (at.length) leaves.push(`${path} [${at.length}]`); return; }
    if (at && typeof at === "object") { for (const [name, inner] of Object.entries(at)) walk(inner, path ? `${path}.${name}` : name, depth + 1); return; }
    if (at === 0 || at === "" || at === null || at === undefined || at === false) return;
    leaves.push(`${path} ${typeof at === "number" ? Number(at.toPrecision(4)) : String(at).slice(0, 40)}`.trim());
  };
  walk(value, "", 0);
  return leaves.slice(0, 5).join(", ");
}
