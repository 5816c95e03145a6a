// What a panel of the page is. Each file of panels/ exports one as `kind`, and build.mjs gathers them: a new panel is a
// file there, and one of the same name in src/ros2_mcp/view/panels, which says what it shows.

import type { Picks } from "./picks.ts";

/** Where a panel stands (style.css). Panels of one place share it: tabs in the head show one of them. */
export type Place = "map" | "image" | "agent" | "values" | "log";
export type Topics = [name: string, type?: string][];

/** What the page gives to its panels. */
export type Page = {
  picks: Picks;
  /** A large part of what is shown, by its key. */
  part(key: string): Promise<Uint8Array<ArrayBuffer>>;
  /** The time of a recording that is shown (Unix time, s); null of the robot now. */
  shownS(): number | null;
  /** `panel` can show nothing any more: the first panel of its place is shown instead, and says why. Without `why` it can again. */
  giveUp(panel: Panel, why: string): void;
};

export interface Panel {
  /** The topic that a person has chosen; empty: the server chooses. Panels without a choice have none. */
  chosen?: string;
  /** Why another panel of the same place is not shown. */
  note?: string;
  /** Whether it can show anything; it is not asked for where not. */
  readonly works?: boolean;
  /** Shows what the server has sent for it: what `show` of its Python class returns. */
  update(content: never): void;
  /** Ten times a second: the server's time (Unix time, s), and whether the server is lost. */
  tick?(nowS: number, lost: boolean): void;
  /** The topics there are, to choose from. */
  offer?(topics: Topics): void;
  /** Something else is picked. */
  mark?(): void;
  /** The colours have changed. */
  repaint?(): void;
}

export type Kind = {
  title: string;
  place: Place;
  /** Smaller numbers come first, on the page and among tabs. */
  order: number;
  /** Whether it is folded to its title while it has nothing to show. */
  folds?: boolean;
  make(section: HTMLElement, page: Page): Panel;
};
