// The newest message of a topic as a tree, and the log of the robot's nodes.

import { Frame, ageText, clock, make, say } from "./dom.ts";

type Values = { why?: string; topic?: string; type?: string; at_s?: number; rate_hz?: number | null; publishers?: string[]; value?: unknown };
type Line = { time: string; level: string; node: string; text: string };

export class ValuesPanel {
  chosen = "";
  private readonly frame: Frame;
  private readonly tree = make("div", { class: "tree" });
  private readonly leaves = new Map<string, HTMLElement>();
  private shape = "";
  private shown: Values = {};
  private topics: string[] = [];

  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Values", false, (topic) => { this.chosen = topic; this.shown = {}; this.tree.replaceChildren(); this.shape = ""; });
    this.frame.body.append(this.tree);
  }

  offer(topics: string[]): void {
    this.topics = topics;
    this.frame.offer(topics, this.chosen || this.shown.topic || "");
  }

  update(values: Values): void {
    this.frame.tell(values.why && !this.shown.value ? values.why : "");
    if (values.value === undefined) { this.frame.tellFoot(values.why && this.shown.value ? [values.why] : []); return; }
    if (values.topic !== this.shown.topic) { this.shown = values; this.offer(this.topics); }
    this.shown = values;
    const leaves = [...flat(values.value, "")];
    const shape = values.topic + leaves.map(([path]) => path).join("\n");
    if (shape !== this.shape) {
      this.shape = shape;
      this.leaves.clear();
      this.tree.replaceChildren(...this.built(values.value, ""));
    }
    for (const [path, text] of leaves) {
      const at = this.leaves.get(path);
      if (!at) continue;
      at.classList.toggle("new", at.textContent !== text && at.textContent !== "");
      say(at, text);
    }
    this.frame.tellFoot([`${values.type ?? ""}${values.publishers?.length ? ` from ${values.publishers.join(", ")}` : ""}`]);
  }

  private built(value: unknown, path: string): HTMLElement[] {
    if (!value || typeof value !== "object") return [];
    return Object.entries(value).map(([name, inner]) => {
      const below = path ? `${path}.${name}` : name;
      if (isBranch(inner)) {
        const branch = make("details", {}, make("summary", {}, name), ...this.built(inner, below));
        branch.open = !["header", "covariance"].includes(name);
        return branch;
      }
      const leaf = make("span");
      this.leaves.set(below, leaf);
      return make("div", {}, make("span", { class: "key" }, `${name}  `), leaf);
    });
  }

  tick(nowS: number, lost: boolean): void {
    if (this.shown.at_s === undefined) return this.frame.tellAge("", false);
    const age = nowS - this.shown.at_s, rate = this.shown.rate_hz;
    this.frame.tellAge(`${rate ? `${rate.toFixed(rate < 10 ? 1 : 0)} Hz · ` : ""}${ageText(age)}`, lost || age > Math.max(2, rate ? 5 / rate : 2));
  }
}

/** What has parts that are read one below the other; a vector, a quaternion or a time stands in one line. */
function isBranch(value: unknown): value is object {
  if (!value || typeof value !== "object") return false;
  const parts = Object.values(value), isFlat = parts.every((one) => typeof one !== "object");
  return !(isFlat && (Array.isArray(value) || (parts.length <= 4 && parts.every((one) => typeof one !== "string" || one.length < 24))));
}

function* flat(value: unknown, path: string): Generator<[string, string]> {
  if (!value || typeof value !== "object") return;
  for (const [name, inner] of Object.entries(value)) {
    const below = path ? `${path}.${name}` : name;
    if (isBranch(inner)) yield* flat(inner, below);
    else yield [below, text(inner)];
  }
}

function text(value: unknown): string {
  if (Array.isArray(value)) return `[${value.map(text).join(", ")}]`;
  if (value && typeof value === "object") return Object.entries(value).map(([name, inner]) => `${name} ${text(inner)}`).join("   ");
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
  return typeof value === "string" ? value || "“”" : String(value);
}

export class LogPanel {
  private readonly frame: Frame;
  private readonly lines = make("ol", { class: "lines" });
  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Log", false);
    this.frame.body.append(this.lines);
  }
  update(log: { why?: string; lines?: Line[] }): void {
    const body = this.frame.body, follows = body.scrollHeight - body.scrollTop - body.clientHeight < 30;
    this.frame.tell(log.why ?? (log.lines?.length ? "" : "No node has said anything of level INFO or above since this page listens."));
    this.lines.replaceChildren(...(log.lines ?? []).map((line) => make("li", { class: /^[A-Z]+$/.test(line.level) ? line.level : undefined },
      make("time", {}, clock(line.time)), make("span", { class: "level" }, line.level),
      make("span", {}, make("span", { class: "node" }, `${line.node}  `), make("span", { class: "text" }, line.text)))));
    if (follows) body.scrollTop = body.scrollHeight;
  }
}
