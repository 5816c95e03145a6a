// The agent: what it does now, what waits for a person, what became of the rest.

import { Frame, clock, make, say } from "../dom.ts";
import type { Kind, Page, Panel } from "../panel.ts";

type Waiting = { id: string; age_s: number; left_s: number; summary: string[] };
type Job = { id: string; kind: string; for_s: number; at_most_s: number | null; doing: string };
type Server = { name: string; answers: boolean; why?: string; mode?: string; moves: string[]; jobs?: Job[]; waiting?: Waiting[]; grants?: { what: string; left_s: number }[]; audit_failed?: string };
type Act = { seq: number | null; time: string; kind: string; who: string; tool?: string; verb?: string; name?: string; type?: string; by?: string; reason?: string; outcome?: string; now?: string; approval?: string; rate_hz?: number; duration_s?: number; for_s?: number; program?: string; value?: unknown };
export type AgentState = { servers?: Server[]; latch?: { by: string; reason: string; since_s: number } | null; acts?: Act[]; folder?: string; why?: string; origin?: string };

const JOBS: Record<string, string> = { recording: "records", program: "runs a program", cancel_when: "watches a condition" };
const VERBS: Record<string, string> = { // of policies
  publish: "publish", relay: "relay", play: "play", record: "record", call: "call", set: "set parameters of", transition: "change the state of", goal: "send a goal to", cancel: "cancel goals of",
};

const ENDED: Record<string, string> = { recording: "recording", program: "program", cancel_when: "watch of a condition" };
const EARLY = /^ended before its time: (.*)$/s; // as the audit writes it
const ENDED_BY: Record<string, string> = { lease: "lease expired", stop: "a stop", latch: "the latch", cancel: "cancelled", stopper: "its stopper died" };
const ANSWER = "ros2-mcp operate";
const END_LONG = 30; // an end that is longer has its reason among what the act says

/** Of what has a word of ours; `constructor` and such are names like others. */
const word = (words: Record<string, string>, name: string): string | undefined => (Object.hasOwn(words, name) ? words[name] : undefined);

export class AgentPanel implements Panel {
  private readonly frame: Frame;
  private readonly waits = make("div");
  private readonly jobs = make("ol", { class: "rows" });
  private readonly origin = make("p", { class: "origin" });
  private readonly rows = make("ol", { class: "rows" });
  private readonly none = make("p", { class: "empty" });
  private asked = ""; // what waits, and is shown: it stays as it is, so that the command can be marked
  private ages: HTMLElement[] = [];
  private foot = "";

  constructor(section: HTMLElement, private readonly page: Page) {
    this.frame = new Frame(section, "Agent", false);
    this.frame.body.append(this.waits, this.jobs, this.origin, this.rows, this.none);
    setInterval(() => this.tellLeft(), 1000);
  }

  /** `shownS` is the time that is shown of a recording, Unix time in s. */
  update(state: AgentState): void {
    const shownS = this.page.shownS();
    this.frame.tell("");
    const servers = state.servers ?? [];
    const waiting = servers.flatMap((server) => server.waiting ?? []);
    const asked = JSON.stringify(waiting.map(({ id, summary }) => [id, summary]));
    if (asked !== this.asked) {
      this.ages = waiting.map(() => make("span"));
      this.waits.replaceChildren(...waiting.map((one, index) => make(
        "div", { class: "waits" }, make("div", {}, make("b", {}, `${one.id} waits for a person`), this.ages[index]),
        ...one.summary.map((line) => make("div", {}, line)), make("div", { class: "answer" }, "Answer it in a terminal: ", make("code", {}, ANSWER)))));
      if (waiting.length) this.frame.body.scrollTop = 0; // what is new of it is seen, wherever somebody has looked
      this.asked = asked;
    }
    waiting.forEach((one, index) => { const at = this.ages[index]; if (at) say(at, ` · asked ${one.age_s} s ago, ${one.left_s} s left`); });
    this.jobs.replaceChildren(...servers.flatMap((server) => server.jobs ?? []).map((job) => make("li", { class: "running" },
      make("time", {}, `${shownS === null ? "" : "now, "}${job.for_s} s`), make("span", { class: "what" }, make("b", {}, word(JOBS, job.kind) ?? job.kind), make("small", {}, ` ${joined([job.doing, job.id])}`)),
      make("span", { class: "end" }, job.at_most_s === null ? "under way" : `of ${job.at_most_s} s`))));
    say(this.origin, state.origin ? `${state.origin}:` : "");
    this.origin.hidden = !state.origin;
    const acts = [...(state.acts ?? [])].reverse(), nowMs = shownS === null ? Date.now() : shownS * 1000;
    const atEnd = this.frame.body.scrollTop;
    this.rows.replaceChildren(...acts.map((act) => row(act, nowMs, shownS === null)));
    this.frame.body.scrollTop = atEnd < 40 ? 0 : atEnd;
    this.tellLeft();
    this.none.hidden = acts.length > 0;
    this.none.textContent = state.origin ? "nothing was done until then." : servers.length ? "Nothing was done yet." : `No server acts on ${state.folder ?? "this robot"} from this machine.`;
    const modes = [...new Set(servers.map((server) => server.mode).filter(Boolean))].join(", ");
    const silent = servers.filter((server) => !server.answers).length;
    const told = `${shownS === null ? "" : "now: "}${servers.length} server${servers.length === 1 ? "" : "s"}${silent ? `, ${silent} NOT answering` : ""}${modes ? ` · ${modes}` : ""}`;
    this.frame.tellAge(told, silent > 0);
    const failed = servers.map((server) => server.audit_failed).filter(Boolean).map((text) => `The audit cannot be written: ${text}.`);
    const grants = servers.flatMap((server) => server.grants ?? []).map(({ what, left_s }) => `Granted: ${what}, ${left_s} s left`);
    const foot = [state.why ?? "", ...failed, ...grants].filter(Boolean);
    if (foot.join("\n") !== this.foot) this.frame.tellFoot(foot.map((text) => make("div", { class: "warn" }, text)));
    this.foot = foot.join("\n");
  }

  /** How long what is under way goes on, which passes also while nothing new is told. */
  private tellLeft(): void {
    for (const at of this.rows.querySelectorAll<HTMLElement>("[data-ends]")) {
      const left = Math.ceil((Number(at.dataset.ends) - Date.now()) / 1000);
      say(at, left > 0 ? `under way, ${left} s left` : "under way");
    }
  }
}

/** An act is under way while its outcome is not written; one whose time is long over has lost its server. */
function isRunning(act: Act, nowMs: number): boolean {
  if (act.kind !== "act" || act.outcome) return false;
  const ends = new Date(act.time).getTime() + ((act.duration_s ?? 60) + 5) * 1000;
  return nowMs < ends;
}

function row(act: Act, nowMs: number, isLive: boolean): HTMLElement {
  const isAct = act.kind === "act" || act.kind === "ended" || act.kind.startsWith("refused") || act.kind === "waits";
  const does = isAct ? word(VERBS, act.verb ?? "") ?? act.verb ?? act.tool ?? act.kind : act.kind;
  const verb = act.kind === "ended" ? `${word(ENDED, does) ?? does} ended` : act.kind === "act" ? inThird(does) : act.kind === "waits" ? `asked to ${does}` : act.kind.startsWith("refused") && act.verb ? `tried to ${does}` : does;
  const often = [act.rate_hz ? `${act.rate_hz} Hz` : "", act.duration_s && act.kind !== "ended" ? `for ${act.duration_s} s` : ""].filter(Boolean).join(" ");
  const value = act.verb === "set" ? parameters(act.value) : brief(act.value);
  const running = isRunning(act, nowMs);
  const early = EARLY.exec(act.outcome ?? "")?.[1];
  const whole = act.kind === "ended" ? "" : running ? "under way" : act.kind.startsWith("refused") ? `refused` : early !== undefined ? `ended early: ${word(ENDED_BY, early) ?? early}` : act.outcome || (act.kind === "waits" ? "waits" : act.kind === "act" && act.seq !== null ? "no outcome" : "");
  const cut = whole.length > END_LONG ? whole.indexOf(":") : -1, end = cut > 0 ? whole.slice(0, cut) : whole, why = cut > 0 ? whole.slice(cut + 1).trim() : "";
  const tone = act.kind.startsWith("refused") || ["latched", "stop"].includes(act.kind) || end.startsWith("failed") || end.startsWith("denied") ? "bad" : ["waits", "no outcome"].includes(end) || end.startsWith("stopped") ? "warn" : "";
  const told = end === "done" && act.verb === "record" ? "begun" : end; // which goes on, among the jobs
  const ends = running && isLive && act.duration_s ? new Date(act.time).getTime() + act.duration_s * 1000 : 0;
  const span = [act.for_s ? `for ${act.for_s} s` : "", act.kind === "ended" && act.duration_s ? `after ${act.duration_s} s` : ""];
  // Of what was refused or failed the reason comes first: what is cut off where it is long is the rest.
  const said = [why, ...(act.kind.startsWith("refused") ? [act.reason, often, value, act.approval] : [often, value, act.approval, act.reason]), ...span, act.by ? `by ${act.by}` : "", act.now];
  return make("li", { class: `${tone}${running ? " running" : ""}`.trim() || undefined, title: [act.tool, act.reason].filter(Boolean).join(": ") },
    make("time", {}, clock(act.time)),
    make("span", { class: "what" }, make("b", {}, verb), act.name ? " " : "", act.name ? make("code", {}, act.name) : "",
      make("small", {}, ` ${joined(said)}`)),
    make("span", { class: "end", title: told, "data-ends": ends ? String(ends) : undefined }, told));
}

/** Parts with a dot between, which begins the line where one is too long: no line ends with a dot that leads nowhere. */
const joined = (parts: (string | undefined)[]): string => parts.filter(Boolean).join(" ·\u00a0");

/** Names and values of a request that sets parameters. */
function parameters(value: unknown): string {
  const given = (value as { parameters?: unknown } | null)?.parameters;
  if (Array.isArray(given)) return given.slice(0, 4).map((one: { name?: unknown; value?: unknown }) => `${String(one?.name ?? "?").slice(0, 60)} = ${parameter(one?.value)}`).join(", ") + (given.length > 4 ? `, and ${given.length - 4} more` : "");
  return brief(value);
}

const PARAMETER = ["", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value", "bool_array_value", "integer_array_value", "double_array_value", "string_array_value"];

/** A ParameterValue (by its type the field that counts), or a plain one. */
function parameter(value: unknown): string {
  const fields = value && typeof value === "object" && !Array.isArray(value) ? value as Record<string, unknown> : null;
  const meant = fields && typeof fields.type === "number" ? fields[PARAMETER[fields.type] ?? ""] : value;
  return meant === undefined ? "not set" : (JSON.stringify(meant) ?? String(meant)).slice(0, 60);
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

export const kind: Kind = { title: "Agent", place: "agent", order: 4, make: (section, page) => new AgentPanel(section, page) };
