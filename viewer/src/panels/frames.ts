// The tree of frames: each below its parent, with who tells it, how often and how long ago, and what is wrong.

import { Frame, make } from "../dom.ts";
import type { Kind, Panel } from "../panel.ts";

type Edge = { parent: string; child: string; static: boolean; publisher: string; rate_hz: number | null; age_s: number | null; problem: string };
type Frames = { why?: string; frames?: number; roots?: string[]; edges?: Edge[]; problems?: string[]; notes?: string[]; at_s?: number };

const STALE_S = 4; // the server tells them each second

export class FramesPanel implements Panel {
  private readonly frame: Frame;
  private readonly table = make("table", { class: "frames-table" });
  private readonly problems = make("ul", { class: "troubles" });
  private readonly folded = new Set<string>();
  private shown: Frames = {};

  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Frames", false);
    this.frame.body.append(this.problems, this.table);
  }

  update(frames: Frames): void {
    this.frame.tell(frames.why && !this.shown.edges ? frames.why : "");
    if (frames.edges) this.shown = frames;
    // A sentence that is of one edge stands at that edge; the others stand above the tree.
    const edges = this.shown.edges ?? [], atEdges = edges.map((edge) => edge.problem).filter(Boolean);
    const general = (this.shown.problems ?? []).filter((text) => !atEdges.some((problem) => text.includes(problem)));
    this.problems.replaceChildren(...general.map((text) => make("li", {}, text)));
    this.problems.hidden = general.length === 0;
    this.build();
    this.frame.tellFoot([...(frames.why && this.shown.edges ? [frames.why] : []), ...(this.shown.notes ?? [])].map((text) => make("div", {}, text)));
  }

  private build(): void {
    const { edges = [], roots = [] } = this.shown;
    const below = new Map<string, Edge[]>(), seen = new Set<string>(), rows: HTMLElement[] = [];
    for (const edge of edges) below.set(edge.parent, [...(below.get(edge.parent) ?? []), edge]);
    // `goesOn` tells of each level above whether another frame follows there: as far a line leads down.
    const add = (name: string, goesOn: boolean[], edge: Edge | null): void => {
      if (seen.has(name)) return; // frames that go in a circle stand here once
      seen.add(name);
      const inner = below.get(name) ?? [], isFolded = this.folded.has(name);
      rows.push(this.row(name, goesOn, edge, inner.length > 0, isFolded));
      inner.forEach((one, index) => { if (isFolded) hide(one.child); else add(one.child, [...goesOn, index < inner.length - 1], one); });
    };
    const hide = (name: string): void => {
      if (seen.has(name)) return;
      seen.add(name);
      for (const one of below.get(name) ?? []) hide(one.child);
    };
    for (const root of roots) add(root, [], null);
    for (const edge of edges) add(edge.child, [], edge); // what no root leads to: a circle
    const active = document.activeElement?.getAttribute("data-frame") ?? null;
    const head = make("tr", {}, ...["Frame", "Published by", "Rate", "Age"].map((text, column) => make("th", { scope: "col", class: column > 1 ? "number" : undefined }, text)));
    this.table.replaceChildren(make("caption", { class: "unseen" }, `${this.shown.frames ?? 0} coordinate frames, each below its parent`),
      make("thead", {}, head), make("tbody", {}, ...rows));
    if (active !== null) [...this.table.querySelectorAll<HTMLElement>("[data-frame]")].find((one) => one.dataset.frame === active)?.focus();
  }

  private row(name: string, goesOn: boolean[], edge: Edge | null, hasMore: boolean, isFolded: boolean): HTMLElement {
    const depth = goesOn.length;
    const steps = goesOn.slice(0, 24).map((more, at) => make("i", { class: `step${at === depth - 1 ? " own" : ""}${more ? " on" : ""}`, "aria-hidden": "true" }));
    const label = hasMore
      ? make("button", { type: "button", class: "fold", "data-frame": name, "aria-expanded": String(!isFolded), title: isFolded ? "Show what is below" : "Hide what is below" }, name)
      : make("span", { class: "leaf" }, name);
    label.addEventListener("click", () => {
      if (!hasMore) return;
      if (isFolded) this.folded.delete(name); else this.folded.add(name);
      this.build();
    });
    const parent = edge && depth > 0 ? make("span", { class: "unseen" }, ` in ${edge.parent}`) : null;
    const problem = edge?.problem ? make("div", { class: "trouble" }, edge.problem) : null;
    const rate = !edge ? "" : edge.static ? "static" : edge.rate_hz ? `${brief(edge.rate_hz)} Hz` : "once";
    const age = !edge || edge.age_s === null ? "" : ageBrief(edge.age_s);
    return make("tr", { class: edge?.problem ? "bad" : undefined },
      make("th", { scope: "row" }, make("div", { class: "branch" }, ...steps, make("div", {}, label, parent, problem))),
      make("td", { class: "by", title: edge?.publisher || undefined }, ...(edge ? breakable(edge.publisher) : ["root"])),
      make("td", { class: "number" }, rate), make("td", { class: "number" }, age));
  }

  tick(nowS: number, lost: boolean): void {
    const { at_s, frames, problems = [] } = this.shown;
    if (at_s === undefined) return this.frame.tellAge("", false);
    const health = problems.length ? `${problems.length} problem${problems.length === 1 ? "" : "s"}` : "no problems";
    this.frame.tellAge(`${frames} frames · ${health}`, lost || nowS - at_s > STALE_S, problems.length > 0);
  }
}

const brief = (value: number): string => (value < 10 ? value.toFixed(1) : value.toFixed(0));

function ageBrief(seconds: number): string {
  if (seconds < 1) return `${Math.round(seconds * 1000)} ms`;
  return seconds < 120 ? `${seconds.toFixed(seconds < 10 ? 1 : 0)} s` : `${Math.round(seconds / 60)} min`;
}

/** A name that may be broken after each _. */
function breakable(name: string): (Node | string)[] {
  return name.split(/(?<=_)/).flatMap((part) => [part, make("wbr")]);
}

export const kind: Kind = { title: "Frames", place: "values", order: 7, make: (section) => new FramesPanel(section) };
