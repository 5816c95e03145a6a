// What the person has picked: a place on the map, a point in 3D, a box in a picture, a time in a plot; told to the
// server, and in a chat to the model.

import { make, say } from "./dom.ts";

/** `at_s` is the time of what was picked, `now_s` that of the picking. */
type Picked = { topic: string; at_s: number; now_s: number };
export type Place = { kind: "place"; x: number; y: number; frame: string; at_s: number; grid?: string; cell?: number; costs?: boolean };
export type Point = Picked & { kind: "point"; frame: string; xyz: number[]; in_frame: string; in: number[] };
export type Box = Picked & { kind: "box"; frame: string; box: number[]; size: number[] };
export type Time = Picked & { kind: "time"; values: { name: string; value: number; unit: string }[] };
export type Pick = Place | Point | Box | Time;

const MOST = 8;

/** The line below the panel in which was picked last: what is picked, and what can be done with it. */
export class Picks {
  readonly bar = make("div", { class: "foot picked", role: "status" });
  list: Pick[] = [];
  /** What the server says of each: its words are what the model reads. */
  lines: string[] = [];
  private readonly told = make("span");
  private readonly where = make("span", { class: "where" }, "On another picture.");
  private readonly ask = make("button", { type: "button" }, "Ask about it");
  private readonly clear = make("button", { type: "button" }, "Clear");

  constructor(private readonly changed: (picks: Pick[]) => Promise<string[]>, private readonly chat: { canSay: boolean; sayForUser(text: string): void } | null, private readonly shown: () => void) {
    this.bar.hidden = true;
    this.where.hidden = true;
    this.bar.append(this.told, this.where, this.ask, this.clear);
    this.ask.addEventListener("click", () => { if (this.lines.length) chat?.sayForUser(this.lines.join("\n")); });
    this.clear.addEventListener("click", () => void this.set([]));
  }

  /** Picks one in a panel, in place of what was picked before or beside it. */
  pick(one: Pick, beside: boolean, section: HTMLElement): void {
    if (this.bar.parentElement !== section) { section.append(this.bar); this.where.hidden = true; }
    void this.set(beside ? [...this.list, one].slice(-MOST) : [one]);
  }

  /** Says in a panel that what is picked is not seen in what it shows now. */
  tellWhere(section: HTMLElement, isSeen: (one: Pick) => boolean): void {
    if (this.bar.parentElement === section) this.where.hidden = !this.list.length || this.list.some(isSeen);
  }

  /** Those of one kind, with their numbers where there are several. */
  of<K extends Pick["kind"]>(kind: K): { one: Extract<Pick, { kind: K }>; label: string }[] {
    return this.list.flatMap((one, index) => (one.kind === kind ? [{ one: one as Extract<Pick, { kind: K }>, label: this.list.length > 1 ? String(index + 1) : "" }] : []));
  }

  /** Tells it again, to a view that does not know it yet. */
  again(): void { if (this.list.length) void this.set(this.list); }

  private async set(list: Pick[]): Promise<void> {
    this.list = list;
    this.lines = [];
    this.bar.hidden = list.length === 0;
    this.ask.hidden = !this.chat?.canSay;
    const what = list.map(brief).join(", ");
    say(this.told, `Picked ${what} …`);
    this.shown();
    try {
      const lines = await this.changed(list);
      if (this.list !== list) return;
      this.lines = lines;
      const depth = /depth there [-\d.]+ m/.exec(lines.at(-1) ?? "")?.[0];
      say(this.told, `Picked ${what}${depth ? `, ${depth}` : ""}. The agent sees it when it asks.`);
    } catch (error) {
      if (this.list === list) say(this.told, `Picked ${what}, but nobody was told (${error instanceof Error ? error.message : "?"})`);
    }
  }
}

export const metres = (numbers: number[]): string => `(${numbers.map((one) => one.toFixed(2)).join(", ")}) m`;

function brief(one: Pick): string {
  if (one.kind === "place") return `${metres([one.x, one.y])} in ${one.frame}`;
  if (one.kind === "point") return `${metres(one.in)} in ${one.in_frame}`;
  if (one.kind === "box") return `${(one.box[2] ?? 0) - (one.box[0] ?? 0) + 1} × ${(one.box[3] ?? 0) - (one.box[1] ?? 0) + 1} pixels of ${one.topic}`;
  return `${new Date(one.at_s * 1000).toTimeString().slice(0, 8)} of ${one.topic}`;
}
