// What is around the robot in three dimensions. It is begun when it is first seen, and drawn only when something is new.

import type { BufferGeometry } from "three";
import { Frame, Notes, ageText, bytesOf, colour, make, oldIn } from "../dom.ts";
import type { Kind, Page, Panel } from "../panel.ts";
import { type Body, type MeshFacts, meshOf } from "../solids.ts";
import { Stage, type Cloud, type Place, type Shape } from "../stage.ts";

type Whence = { name: string; frame: string; at_s: number; from_before: boolean; pose: number[] };
type Space = {
  why?: string; frame?: string; base?: string; frames?: Place[]; clouds?: string[];
  cloud?: (Cloud & Whence & { key: string; points: number; cell_m: number }) | null;
  scans?: Whence[]; model?: { key: string; shapes: number; meshes: number } | null;
  markers?: { key: string; count: number; poses: number[][]; at_s: number } | null;
  missing?: string[]; old?: string[]; told_s?: number | null; bulk?: string[];
};

const STALE_S = 3;
const CLICK_PX = 4; // what moves by less is no turning
const REACH_PX = 12;
const REACH_FROM_MIDDLE_PX = 80;
const NO_WEBGL = "This browser gives no WebGL, without which nothing can be drawn in 3D here. The map and all the others go on.";

const LOST = "The graphics of this machine have dropped the picture in 3D. It comes back as soon as they give it again, or when the page is loaded anew.";
const GONE = "3D is off: the graphics of this machine have dropped its picture and not given it back. The map shows the same from above; loading the page anew may bring 3D back.";
const GONE_MS = 8000; // a driver that begins anew takes a second or two

export class SpacePanel implements Panel {
  chosen = "";
  /** Whether it can be drawn here; what cannot is not asked for. */
  works = true;
  private readonly frame: Frame;
  private readonly notes: Notes;
  private readonly names = make("div", { class: "names", "aria-hidden": "true" });
  private readonly canvas = make("canvas", { role: "img", class: "shown", tabindex: "0", "aria-label": "3D: nothing has come yet" });
  private stage: Stage | null = null;
  private shown: Space = {};
  private cloudKey = "";
  private drawn: Whence | null = null; // the cloud whose points are seen
  private nowS = 0;
  private modelKey = "";
  private markersKey = "";
  private drawnMarkers = 0;
  private drawnModel: Space["model"] = null;
  private readonly meshes = new Map<string, BufferGeometry>();
  private busy = false;
  private isLost = false;
  private goneTimer = 0;
  /** Is told when 3D ends while it is shown, and with an empty text when it comes back. */

  constructor(private readonly section: HTMLElement, private readonly page: Page) {
    this.frame = new Frame(section, "3D", true, (topic) => { this.chosen = topic; });
    this.notes = new Notes(this.frame, "things are not drawn, or not whole");
    this.frame.choice.setAttribute("aria-label", "Cloud");
    this.frame.body.append(this.canvas, this.names);
    for (const [event, isLost] of [["webglcontextlost", true], ["webglcontextrestored", false]] as const) {
      this.canvas.addEventListener(event, () => this.lose(isLost));
    }
    this.canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === "Enter") this.pick(this.canvas.clientWidth / 2, this.canvas.clientHeight / 2, REACH_FROM_MIDDLE_PX, event.shiftKey);
      else if (!this.stage?.press(event.key)) return;
      event.preventDefault();
    });
    let began = [0, 0];
    this.canvas.addEventListener("pointerdown", (event) => { began = [event.offsetX, event.offsetY]; });
    this.canvas.addEventListener("pointerup", (event) => {
      if (event.button === 0 && Math.hypot(event.offsetX - (began[0] ?? 0), event.offsetY - (began[1] ?? 0)) < CLICK_PX) this.pick(event.offsetX, event.offsetY, REACH_PX, event.shiftKey);
    });
    new ResizeObserver(() => {
      if (!this.begin()) return;
      this.stage?.resize(this.frame.body.clientWidth, this.frame.body.clientHeight);
    }).observe(this.frame.body);
  }

  /** Begins drawing as soon as it has a size, which is when it is first seen. */
  private begin(): boolean {
    if (this.stage || !this.works) return this.works;
    if (!this.frame.body.clientWidth) return false;
    try { this.stage = Stage.on(this.canvas, this.names); } catch { this.stage = null; }
    this.works = this.stage !== null;
    if (!this.works) { this.canvas.hidden = true; this.frame.tell(NO_WEBGL); }
    this.repaint();
    return this.works;
  }

  update(space: Space): void {
    if (!this.works) return;
    this.tellWhy(space.why);
    this.notes.tell([...(space.why && this.shown.frame ? [space.why] : []), ...missingIn(space)], oldIn(space.old));
    if (space.frame === undefined || !this.begin()) return;
    const isOther = space.frame !== this.shown.frame;
    this.shown = space;
    this.frame.offer(space.clouds ?? [], this.chosen || space.cloud?.name || "");
    const stage = this.stage;
    if (!stage) return;
    stage.place(space.frames ?? [], space.base ?? "", isOther, !!space.cloud || !!space.scans?.length || !!space.markers);
    stage.scan((space.scans ?? []).map((scan, index) => ({ pose: scan.pose, xy: new Float32Array(bytesOf(space.bulk?.[index] ?? "").buffer) })));
    if (!space.cloud) { stage.cloud(null); [this.cloudKey, this.drawn] = ["", null]; }
    else if (space.cloud.key === this.cloudKey) { stage.moveCloud(space.cloud.pose); this.drawn = space.cloud; } // the same points, elsewhere: what they are in has moved
    if (!space.markers) { stage.mark3d([], this.meshes); [this.markersKey, this.drawnMarkers] = ["", 0]; }
    else if (space.markers.key === this.markersKey) stage.moveMarkers(space.markers.poses);
    if (!this.busy) void this.fetch();
    if (isOther) this.mark();
    this.tellWords();
    stage.dirty();
  }

  /** The graphics have dropped the picture, or given it back. */
  private lose(isLost: boolean): void {
    this.isLost = isLost;
    clearTimeout(this.goneTimer);
    this.turn(true);
    this.tellWhy();
    if (!isLost) { requestAnimationFrame(() => this.repaint()); return; } // after three, which begins with a black ground
    this.stage?.drop();
    this.goneTimer = window.setTimeout(() => this.turn(false), GONE_MS);
  }

  /** On, or off: then the page is what it is without WebGL. */
  private turn(on: boolean): void {
    if (!on && document.hidden) { this.goneTimer = window.setTimeout(() => this.turn(false), GONE_MS); return; } // nobody looks, so nothing is given
    if (on === this.works) return;
    [this.works, this.canvas.hidden, this.names.hidden] = [on, !on, !on];
    this.frame.tell(on ? "" : GONE);
    if (!on) this.notes.tell([]);
    this.page.giveUp(this, on ? "" : GONE);
  }

  /** Why nothing is seen, if that is so. */
  private tellWhy(why = ""): void {
    this.frame.tell(this.isLost ? LOST : this.shown.frame ? "" : why);
  }

  private pick(x: number, y: number, reach: number, beside: boolean): void {
    const seen = this.stage?.nearest(x, y, reach), of = seen && (seen.scan < 0 ? this.drawn : this.shown.scans?.[seen.scan]);
    if (!seen || !of) return;
    this.page.picks.pick({ kind: "point", topic: of.name, frame: of.frame, xyz: seen.xyz, in_frame: this.shown.frame ?? "", in: seen.at, at_s: of.at_s, now_s: this.nowS }, beside, this.section);
  }

  /** Marks what is picked, here and on the map. */
  mark(): void {
    const points = this.page.picks.of("point").map(({ one, label }) => ({ frame: one.in_frame, at: one.in, label }));
    const places = this.page.picks.of("place").map(({ one, label }) => ({ frame: one.frame, at: [one.x, one.y, 0], label }));
    this.stage?.mark([...points, ...places].filter(({ frame }) => frame === this.shown.frame));
  }

  /** Fetches what is large, one after the other: of clouds that come faster only the newest counts. */
  private async fetch(): Promise<void> {
    this.busy = true;
    try {
      const { cloud, markers, model } = this.shown;
      if (model && model.key !== this.modelKey) {
        const shapes = JSON.parse(new TextDecoder().decode(await this.unpacked(model.key))) as Shape[];
        await this.fetchMeshes(shapes.map((shape) => shape.mesh));
        this.stage?.model(shapes, this.meshes);
        [this.modelKey, this.drawnModel] = [model.key, model];
      }
      if (markers && markers.key !== this.markersKey) {
        const bodies = JSON.parse(new TextDecoder().decode(await this.unpacked(markers.key))) as Body[];
        await this.fetchMeshes(bodies.map((body) => body.mesh ?? null));
        this.stage?.mark3d(bodies, this.meshes);
        this.stage?.moveMarkers(markers.poses);
        [this.markersKey, this.drawnMarkers] = [markers.key, bodies.length];
      }
      if (cloud && cloud.key !== this.cloudKey) {
        const bytes = await this.unpacked(cloud.key);
        if (bytes.length >= cloud.count * 6) this.stage?.cloud(cloud, bytes, cloud.pose);
        [this.cloudKey, this.drawn] = [cloud.key, cloud];
      }
      this.tellWords();
      this.stage?.dirty();
    } catch { /* the next update names what is there by then */ } finally { this.busy = false; }
  }

  /** Fetches the meshes that are not here yet, each once; one that cannot be read is not drawn. */
  private async fetchMeshes(wanted: (MeshFacts | null)[]): Promise<void> {
    for (const facts of wanted) {
      if (!facts || this.meshes.has(facts.key)) continue;
      const made = meshOf(facts, await this.unpacked(facts.key));
      if (made) this.meshes.set(facts.key, made);
    }
  }

  private async unpacked(key: string): Promise<Uint8Array<ArrayBuffer>> {
    const stream = new Blob([await this.page.part(key)]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  private tellWords(): void { this.canvas.setAttribute("aria-label", this.inWords()); }

  private inWords(): string {
    const { frame, frames = [], base, cloud, scans = [] } = this.shown, model = this.drawnModel, count = this.drawnMarkers;
    const at = frames.find((one) => one.name === base)?.pose;
    const where = at ? `Robot at ${at.slice(0, 3).map((value) => value.toFixed(2)).join(", ")} metres in ${frame}.` : `Seen in ${frame}; nobody says where the robot is.`;
    const seen = [!cloud ? "no cloud" : this.drawn?.name === cloud.name ? `${cloud.count} points of ${cloud.name}` : `${cloud.name} is on its way`, `${scans.length} scan${scans.length === 1 ? "" : "s"}`, `${frames.length} frames`, model ? `${model.shapes} shapes of the robot${model.meshes ? `, ${model.meshes} of them meshes` : ""}` : "no robot model", ...(count ? [`${count} marker${count === 1 ? "" : "s"}`] : [])];
    return `3D. ${where} ${seen.join(", ")}.`;
  }

  tick(nowS: number, lost: boolean): void {
    this.nowS = nowS;
    const { frame, cloud, scans = [], told_s } = this.shown;
    if (!frame || !this.works) return this.frame.tellAge("", false);
    const times = [cloud?.at_s, ...scans.map((scan) => scan.at_s), told_s].filter((at): at is number => typeof at === "number");
    const age = nowS - Math.max(...times);
    const isOld = times.length > 0 && age > STALE_S || (!!cloud && nowS - cloud.at_s > STALE_S);
    this.frame.tellAge(times.length ? `${frame} · ${cloud ? `cloud ${ageText(nowS - cloud.at_s, cloud.from_before)}` : ageText(age)}` : frame, lost || isOld);
  }

  repaint(): void { this.stage?.paint(colour("deep"), colour("line-deep"), colour("soft"), document.documentElement.dataset.theme === "dark"); }
}

/** Sentences about what is not drawn, or not whole. */
function missingIn({ cloud, missing = [] }: Space): string[] {
  return [...(cloud?.cell_m ? [`${cloud.count} of ${cloud.points} points are drawn: one in each ${Number(cloud.cell_m.toPrecision(2))} m.`] : []), ...missing];
}

export const kind: Kind = { title: "3D", place: "map", order: 2, make: (section, page) => new SpacePanel(section, page) };
