// The log of the robot's nodes.

import { Frame, clock, make } from "../dom.ts";
import type { Kind, Panel } from "../panel.ts";

type Line = { time: string; level: string; node: string; text: string };

class LogPanel implements Panel {
  private readonly frame: Frame;
  private readonly lines = make("ol", { class: "lines" });
  constructor(section: HTMLElement) {
    this.frame = new Frame(section, "Log", false);
    this.frame.body.append(this.lines);
  }
  /** The newest first, as in the Agent panel; who has scrolled to an older one stays there. */
  update(log: { why?: string; lines?: Line[] }): void {
    const body = this.frame.body, from = body.scrollTop, height = body.scrollHeight;
    this.frame.tell(log.why ?? (log.lines?.length ? "" : "No node has said anything of level INFO or above since this page listens."));
    this.lines.replaceChildren(...[...(log.lines ?? [])].reverse().map((line) => make("li", { class: /^[A-Z]+$/.test(line.level) ? line.level : undefined },
      make("time", {}, clock(line.time)), make("span", { class: "level" }, line.level),
      make("span", {}, make("span", { class: "node" }, `${line.node}  `), make("span", { class: "text" }, line.text)))));
    body.scrollTop = from < 30 ? 0 : from + body.scrollHeight - height;
  }
}

export const kind: Kind = { title: "Log", place: "log", order: 8, folds: true, make: (section) => new LogPanel(section) };
