// The newest message of a topic as a tree.

import { Frame, ageText, make, rateText, say } from "../dom.ts";
import type { Kind, Panel, Topics } from "../panel.ts";

type Values = { why?: string; topic?: string; type?: string; at_s?: number; from_before?: boolean; rate_hz?: number | null; publishers?: string[]; value?: unknown };

export class ValuesPanel implements Panel {
  chosen = "";
  private readonly frame: Frame;
  private readonly tree = make("div", { class: "tree" });
  private readonly leaves = new Map<string, HTMLElement>();
  private shape = "";
  private shown: Values = {};
  private topics: Topics = [];

  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Values", false, (topic) => { this.chosen = topic; this.shown = {}; this.tree.replaceChildren(); this.shape = ""; });
    this.frame.body.append(this.tree);
  }

  offer(topics: Topics): void {
    this.topics = topics;
    this.frame.offer(topics.map(([name]) => name), this.chosen || this.shown.topic || "");
  }

  update(values: Values): void {
    this.frame.tell(values.why && !this.shown.value ? values.why : "");
    if (values.value === undefined) { this.frame.tellFoot(values.why && this.shown.value ? [values.why] : []); return; }
    if (values.topic !== this.shown.topic) { this.shown = values; this.offer(this.topics); }
    this.shown = values;
    const leaves = [...flat(values.value, "")];
    const shape = values.topic + leaves.map(({ path }) => path).join("\n");
    if (shape !== this.shape) {
      this.shape = shape;
      this.leaves.clear();
      this.tree.replaceChildren(...this.built(values.value, ""));
    }
    for (const { path, text } of leaves) {
      const at = this.leaves.get(path);
      if (!at) continue;
      at.classList.toggle("new", at.textContent !== text && at.textContent !== "");
      say(at, text);
    }
    this.frame.tellFoot([`${values.type ?? ""}${values.publishers?.length ? ` from ${values.publishers.join(", ")}` : ""}`]);
  }

  /** What tells how it is comes first; what hardly changes (header, covariance, names of frames) last. */
  private built(value: unknown, path: string): HTMLElement[] {
    if (!value || typeof value !== "object") return [];
    const rows: HTMLElement[] = [], last: HTMLElement[] = [], joints = parallel(value);
    if (joints) rows.push(this.jointed(joints, value as Record<string, unknown[]>, path));
    for (const [name, inner, below] of partsOf(value, path)) {
      if (joints && (name === "name" || joints.includes(name))) continue;
      const whole = path ? below.slice(path.length + 1) : below; // `pose.pose` where there is nothing to be said of the outer one
      const isDull = DULL.test(name);
      (isDull ? last : rows).push(isBranch(inner) ? this.branch(whole, inner, below, !isDull) : make("div", {}, make("span", { class: "key" }, `${whole}  `), ...this.line(inner, below)));
    }
    return [...rows, ...last];
  }

  private branch(name: string, inner: object, below: string, isOpen: boolean): HTMLElement {
    const branch = make("details", {}, make("summary", {}, name), ...this.built(inner, below));
    branch.open = isOpen;
    return branch;
  }

  /** One line: of a vector or list each part by itself, so that what has changed is told of that part alone. */
  private line(value: unknown, path: string): HTMLElement[] {
    const parts = lineOf(value, path);
    const spans = parts.map(({ path: at, key }) => {
      const leaf = make("span");
      this.leaves.set(at, leaf);
      return make("span", { class: "part" }, key ? make("span", { class: "key" }, `${key} `) : null, leaf);
    });
    if (!Array.isArray(value)) return spans.flatMap((span, index) => (index ? [make("span", {}, "   "), span] : [span]));
    return [make("span", {}, "["), ...spans.flatMap((span, index) => (index ? [make("span", {}, ", "), span] : [span])), make("span", {}, "]")];
  }

  /** Lists that go along with the names of joints: a row for each joint. */
  private jointed(lists: string[], value: Record<string, unknown[]>, path: string): HTMLElement {
    const names = value.name ?? [];
    return make("table", { class: "joints" }, make("thead", {}, make("tr", {}, make("th", { scope: "col" }, "name"), ...lists.map((list) => make("th", { scope: "col", class: "number" }, list)))),
      make("tbody", {}, ...names.map((name, index) => make("tr", {}, make("th", { scope: "row" }, String(name)), ...lists.map((list) => {
        const cell = make("td", { class: "number" });
        this.leaves.set(`${path ? `${path}.` : ""}${list}.${index}`, cell);
        return cell;
      })))));
  }

  tick(nowS: number, lost: boolean): void {
    if (this.shown.at_s === undefined) return this.frame.tellAge("", false);
    const age = nowS - this.shown.at_s, rate = this.shown.rate_hz, isOld = lost || age > Math.max(2, rate ? 5 / rate : 2);
    this.frame.tellAge(`${rateText(rate, isOld)}${ageText(age, this.shown.from_before)}`, isOld);
  }
}

type Leaf = { path: string; key: string; text: string };

const DULL = /^(header|.*covariance|child_frame_id|frame_id)$/;
const JOINT_DIGITS = 4;

/** What has parts that are read one below the other; a vector, a quaternion or a time stands in one line. */
function isBranch(value: unknown): value is object {
  if (!value || typeof value !== "object") return false;
  const parts = Object.values(value), isFlat = parts.every((one) => typeof one !== "object");
  return !(isFlat && (Array.isArray(value) || (parts.length <= 4 && parts.every((one) => typeof one !== "string" || one.length < 24))));
}

/** The parts of a value with their paths. One that has nothing but another branch, and what is dull, is passed over: its
 * parts stand here with the names of both (`pose.pose`, `pose.covariance`). */
function partsOf(value: object, path: string): [name: string, inner: unknown, below: string][] {
  return Object.entries(value).flatMap(([name, inner]): [string, unknown, string][] => {
    const below = path ? `${path}.${name}` : name;
    if (!isBranch(inner) || Array.isArray(inner) || DULL.test(name)) return [[name, inner, below]];
    const within = Object.entries(inner), telling = within.filter(([key]) => !DULL.test(key));
    if (telling.length !== 1 || within.length < 2 || !isBranch(telling[0]?.[1])) return [[name, inner, below]];
    return within.map(([key, one]) => [key, one, `${below}.${key}`]);
  });
}

/** The lists of numbers that are as long as the list `name` beside them, as joint states have them; null if there are none. */
function parallel(value: object): string[] | null {
  const lists = value as Record<string, unknown>, names = lists.name;
  if (!Array.isArray(names) || !names.length || !names.every((one) => typeof one === "string")) return null;
  const found = Object.entries(lists).filter(([, one]) => Array.isArray(one) && one.length === names.length && one.every((number) => typeof number === "number")).map(([name]) => name);
  return found.length ? found : null;
}

/** What is shown of a value, in parts that change each by itself. */
function* flat(value: unknown, path: string): Generator<Leaf> {
  if (!value || typeof value !== "object") return;
  const joints = parallel(value);
  for (const [name, inner, below] of partsOf(value, path)) {
    if (joints?.includes(name)) for (const [index, one] of (inner as number[]).entries()) yield { path: `${below}.${index}`, key: "", text: fixed(one) };
    else if (joints && name === "name") yield* (inner as string[]).map((one, index) => ({ path: `${below}.${index}.${one}`, key: "", text: one })); // other joints are another shape
    else if (isBranch(inner)) yield* flat(inner, below);
    else yield* lineOf(inner, below);
  }
}

function lineOf(value: unknown, path: string): Leaf[] {
  if (Array.isArray(value)) return value.map((one, index) => ({ path: `${path}.${index}`, key: "", text: text(one) }));
  if (value && typeof value === "object") return Object.entries(value).map(([name, inner]) => ({ path: `${path}.${name}`, key: name, text: text(inner) }));
  return [{ path, key: "", text: text(value) }];
}

function text(value: unknown): string {
  if (Array.isArray(value)) return `[${value.map(text).join(", ")}]`;
  if (value && typeof value === "object") return Object.entries(value).map(([name, inner]) => `${name} ${text(inner)}`).join("   ");
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(Number(brief(value)));
  return typeof value === "string" ? value || "“”" : String(value);
}

/** Six digits, of what is small only as many as are of use: the others are noise that changes all the time. */
function brief(value: number): string {
  const size = Math.abs(value);
  return size >= 1 ? value.toPrecision(6) : size >= 1e-3 ? value.toFixed(5) : value.toPrecision(3);
}

/** A joint's number: what moves by less than its last digit stands still here. */
const fixed = (value: number): string => value.toFixed(JOINT_DIGITS).replace(/^-(0\.0+)$/, "$1");

export const kind: Kind = { title: "Values", place: "values", order: 5, folds: true, make: (section) => new ValuesPanel(section) };
