// What the person has picked: places on the map, told to the server, and in a chat to the model.

import { make, say } from "./dom.ts";

export type Pick = { x: number; y: number; frame: string; at_s: number; grid?: string; cell?: number; costs?: boolean };

const MOST = 8;

/** The line below the map: what is picked, and what can be done with it. */
export class Picks {
  readonly bar = make("div", { class: "picked", role: "status" });
  list: Pick[] = [];
  /** What the server says of each: its words are what the model reads. */
  lines: string[] = [];
  private readonly told = make("span");
  private readonly ask = make("button", { type: "button" }, "Ask about it");
  private readonly clear = make("button", { type: "button" }, "Clear");

  constructor(private readonly changed: (picks: Pick[]) => Promise<string[]>, private readonly chat: { canSay: boolean; sayForUser(text: string): void } | null, private readonly shown: () => void) {
    this.bar.hidden = true;
    this.bar.append(this.told, this.ask, this.clear);
    this.ask.addEventListener("click", () => { if (this.lines.length) chat?.sayForUser(this.lines.join("\n")); });
    this.clear.addEventListener("click", () => void this.set([]));
  }

  pick(one: Pick, beside: boolean): void { void this.set(beside ? [...this.list, one].slice(-MOST) : [one]); }

  /** Tells it again, to a view that does not know it yet. */
  again(): void { if (this.list.length) void this.set(this.list); }

  private async set(list: Pick[]): Promise<void> {
    this.list = list;
    this.lines = [];
    this.bar.hidden = list.length === 0;
    this.ask.hidden = !this.chat?.canSay;
    const where = list.map((one) => `(${one.x.toFixed(2)}, ${one.y.toFixed(2)})`).join(", ");
    say(this.told, `Picked ${where} m in ${list.at(-1)?.frame ?? ""} …`);
    this.shown();
    try {
      const lines = await this.changed(list);
      if (this.list !== list) return;
      this.lines = lines;
      say(this.told, `Picked ${where} m in ${list.at(-1)?.frame ?? ""}. The agent sees it when it asks.`);
    } catch (error) {
      if (this.list === list) say(this.told, `Picked ${where} m, but nobody was told (${error instanceof Error ? error.message : "?"})`);
    }
  }
}
