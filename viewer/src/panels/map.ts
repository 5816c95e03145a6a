// The map: what is around the robot, from above. Drag moves, the wheel or + and - zoom, 0 shows all; a click picks a
// place, with Shift one more; Enter picks the middle.

import { Frame, Notes, Sheet, ageText, bytesOf, colour, oldIn } from "../dom.ts";
import type { Kind, Page, Panel } from "../panel.ts";

type Mark = { name: string; x: number; y: number; yaw: number | null };
type Grid = { key: string; name: string; width: number; height: number; resolution: number; costs: boolean; colours?: string; x: number; y: number; yaw: number };
type Around = {
  why?: string; frame?: string; grids?: string[];
  robot?: { x: number; y: number; z: number; yaw: number; at_s: number | null; reckoned: { x: number; y: number; z: number; yaw: number; at_s: number } | null } | null;
  grid?: Grid | null; footprint?: [number, number][] | null; limbs?: Limb[];
  paths?: { name: string; points: [number, number][] }[]; goals?: Mark[]; places?: Mark[];
  layers?: { kind: string; name: string; at_s: number | null }[]; missing?: string[]; old?: string[]; bulk?: string[];
};
/** A link that joints move, from above; `bone` leads to it from the link that holds it. */
type Limb = { outline: [number, number][]; bone: [[number, number], [number, number]] | null; jointed: boolean };
/** Where the robot was at a time (Unix, s), in metres and radians of the frame that is shown. */
type Pose = { at: number; x: number; y: number; z: number; yaw: number };
type Tint = [number, number, number];

const MOST_TRAIL = 3000;
const STALE_S = 3; // at most; of what comes often a few missed turns are enough
const SOON_S = 1.2, TURNS = 4;
const MOST_POSES = 12;
// Over how many seconds a speed is told, and what is less than any (m/s, rad/s): by odometry, and by a localisation, which trembles by a centimetre from pose to pose.
const RECKONED = { overS: 0.7, stillMps: 0.01, stillRadps: 0.02 }, LOCALISED = { overS: 1.6, stillMps: 0.03, stillRadps: 0.04 };
const CLICK_PX = 4; // what moves by less is no drag
const FLAT_M = 0.05; // as ros2_scene: less is no height

export class MapPanel implements Panel {
  chosen = "";
  private readonly frame: Frame;
  private readonly sheet: Sheet;
  private readonly notes: Notes;
  private around: Around = {};
  private scans: Float32Array[] = [];
  private cells = new Map<string, Uint8Array>();
  private asked = new Set<string>();
  private ground: { key: string; canvas: HTMLCanvasElement } | null = null;
  private trail: [number, number][] = [];
  private before: number | null = null;
  private poses: (Pose & { frame: string })[] = []; // the last ones
  private judged = LOCALISED;
  /** For how long nothing has been heard of where the robot is, in s. */
  silentS = 0;
  /** Whether what is shown is older than it should be. */
  isOld = false;
  private centre: [number, number] = [0, 0];
  private scale = 0; // pixels for each metre; 0: fit
  private fitted = true;
  private pointer: [number, number] | null = null;

  private nowS = 0;
  /** What the page has to say below it. */
  note = "";

  constructor(private readonly section: HTMLElement, private readonly page: Page) {
    this.frame = new Frame(section, "Map", true, (topic) => { this.chosen = topic; this.fitted = true; });
    this.notes = new Notes(this.frame, "things are not shown, or not whole");
    this.sheet = new Sheet(this.frame.body, () => this.draw());
    const canvas = this.sheet.canvas;
    canvas.classList.add("shown");
    canvas.tabIndex = 0;
    let from: [number, number] | null = null, began: [number, number] = [0, 0];
    canvas.addEventListener("pointerdown", (event) => { began = from = [event.offsetX, event.offsetY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", (event) => {
      const isClick = from && event.button === 0 && Math.hypot(event.offsetX - began[0], event.offsetY - began[1]) < CLICK_PX;
      from = null;
      if (isClick) this.pick(...this.toMetres(event.offsetX, event.offsetY), event.shiftKey);
    });
    canvas.addEventListener("pointercancel", () => { from = null; });
    for (const name of ["focus", "blur"]) canvas.addEventListener(name, () => this.draw());
    canvas.addEventListener("pointerleave", () => { this.pointer = null; this.draw(); });
    canvas.addEventListener("pointermove", (event) => {
      this.pointer = [event.offsetX, event.offsetY];
      if (from && Math.hypot(event.offsetX - began[0], event.offsetY - began[1]) >= CLICK_PX) { this.move(event.offsetX - from[0], event.offsetY - from[1]); from = [event.offsetX, event.offsetY]; }
      this.draw();
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY); }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.press(event));
  }

  /** What cannot be shown leaves what is shown as it is; raises then. */
  update(around: Around): void {
    const before = this.around;
    try { this.take(around); } catch (error) { this.around = before; throw error; }
  }

  private take(around: Around): void {
    if (around.frame !== this.around.frame) { this.trail = []; this.fitted = true; }
    if (around.grid?.name !== this.around.grid?.name) this.fitted = true;
    this.around = around;
    this.scans = (around.bulk ?? []).map((text) => new Float32Array(bytesOf(text).buffer));
    const at = around.robot, then = this.before;
    if (at?.at_s && then && at.at_s < then) this.trail = []; // an earlier time of a recording
    this.before = at?.at_s ?? null;
    this.keepPose();
    const last = this.trail.at(-1);
    if (at && last && Math.hypot(at.x - last[0], at.y - last[1]) > 3) this.trail = []; // set anew, or another time
    if (at && (!last || Math.hypot(at.x - last[0], at.y - last[1]) > 0.02)) this.trail.push([at.x, at.y]);
    if (this.trail.length > MOST_TRAIL) this.trail = this.trail.filter((_, index) => index % 2 === 0);
    this.frame.offer(around.grids ?? [], this.chosen || around.grid?.name || "");
    this.frame.tell(around.why ?? "");
    this.notes.tell(around.missing ?? [], [this.note, oldIn(around.old)].filter(Boolean).join(" "));
    if (around.grid) void this.fetchCells(around.grid.key);
    this.sheet.canvas.setAttribute("aria-label", this.inWords());
    this.draw();
  }

  /** The last poses, of which the speed is told; anew in another frame, or at an earlier time of a recording. */
  private keepPose(): void {
    const { robot } = this.around, at = robot?.reckoned ?? robot, last = this.poses.at(-1);
    const frame = `${this.around.frame} ${robot?.reckoned ? "reckoned" : ""}`;
    this.judged = robot?.reckoned ? RECKONED : LOCALISED;
    if (!at || at.at_s === null || (last && (last.frame !== frame || at.at_s < last.at))) this.poses = [];
    if (at && at.at_s !== null && at.at_s !== this.poses.at(-1)?.at) this.poses = [...this.poses, { x: at.x, y: at.y, z: at.z, yaw: at.yaw, at: at.at_s, frame }].slice(-MOST_POSES);
  }

  private inWords(): string {
    const { robot, frame, goals = [], places = [] } = this.around;
    const where = robot ? `Robot at ${robot.x.toFixed(2)}, ${robot.y.toFixed(2)} metres in ${frame}${this.height(", ", " high")}, heading ${Math.round((robot.yaw * 180) / Math.PI)} degrees.` : "Nobody says where the robot is.";
    const named = [...goals, ...places].map((mark) => `${mark.name} at ${mark.x.toFixed(1)}, ${mark.y.toFixed(1)}`);
    const picked = this.page.picks.of("place").map(({ one }) => `Picked ${one.x.toFixed(2)}, ${one.y.toFixed(2)}.`);
    return `Map. ${where} ${named.slice(0, 8).join("; ")} ${picked.join(" ")}`.trim();
  }

  tick(nowS: number, lost: boolean): void {
    this.nowS = nowS;
    const at = this.around.robot?.at_s ?? null;
    const age = at === null ? NaN : nowS - at;
    const turns = this.poses.slice(1).map((one, index) => one.at - (this.poses[index]?.at ?? one.at));
    const stale = lost || age > Math.min(STALE_S, Math.max(SOON_S, TURNS * Math.max(0, ...turns)));
    [this.silentS, this.isOld] = at === null ? [0, false] : [age, stale];
    const told = !this.around.robot ? "pose unknown" : at === null ? "fixed" : `pose ${ageText(age)}`;
    this.frame.tellAge(this.around.frame ? `${this.around.frame} · ${this.height("", " up · ")}${told}` : "", stale);
  }

  /** Its speed along and around, as far as its poses tell; null where they do not. */
  private get speed(): { mps: number; radps: number } | null {
    const end = this.poses.at(-1)?.at ?? 0, recent = this.poses.filter((one) => end - one.at <= this.judged.overS), half = Math.floor(recent.length / 2);
    if (half < 1) return null;
    const before = middle(recent.slice(0, half)), after = middle(recent.slice(-half)), s = after.at - before.at;
    if (s < this.judged.overS / 8) return null;
    return { mps: Math.hypot(after.x - before.x, after.y - before.y, after.z - before.z) / s, radps: Math.atan2(Math.sin(after.yaw - before.yaw), Math.cos(after.yaw - before.yaw)) / s };
  }

  private get isMoving(): boolean {
    const speed = this.speed;
    return !!speed && (speed.mps > this.judged.stillMps || Math.abs(speed.radps) > this.judged.stillRadps);
  }

  /** What the robot does, in words; empty where its poses do not tell. */
  get inMotion(): string {
    const speed = this.speed;
    if (!speed) return "";
    if (!this.isMoving) return this.height("robot hovers ", " up") || "robot stands";
    const parts = [speed.mps > this.judged.stillMps ? `${speed.mps.toFixed(2)} m/s` : "", Math.abs(speed.radps) > this.judged.stillRadps ? `turns ${Math.abs(Math.round((speed.radps * 180) / Math.PI))}°/s ${speed.radps > 0 ? "left" : "right"}` : "", this.height("", " up")];
    return `robot moves ${parts.filter(Boolean).join(", ")}`;
  }

  /** How high the robot is, between these words; empty where it is on the ground. */
  private height(before: string, after: string): string {
    const z = this.around.robot?.z ?? 0;
    return Math.abs(z) < FLAT_M ? "" : `${before}${z.toFixed(2)} m${after}`;
  }

  private pick(x: number, y: number, beside: boolean): void {
    const { frame, grid } = this.around;
    if (!frame || this.scale <= 0) return;
    this.page.picks.pick({ kind: "place", x, y, frame, at_s: this.nowS, ...(grid ? this.cellAt(grid, x, y) : {}) }, beside, this.section);
    this.draw();
  }

  private cellAt(grid: Grid, x: number, y: number): { grid?: string; cell?: number; costs?: boolean } {
    const [cos, sin] = [Math.cos(grid.yaw), Math.sin(grid.yaw)], [dx, dy] = [x - grid.x, y - grid.y];
    const column = Math.floor((cos * dx + sin * dy) / grid.resolution), row = Math.floor((cos * dy - sin * dx) / grid.resolution);
    if (column < 0 || row < 0 || column >= grid.width || row >= grid.height) return {};
    const cell = this.cells.get(grid.key)?.[row * grid.width + column];
    return cell === undefined ? {} : { grid: grid.name, cell, costs: grid.costs };
  }

  repaint(): void { this.ground = null; this.draw(); }

  private async fetchCells(key: string): Promise<void> {
    if (this.cells.has(key) || this.asked.has(key)) return;
    this.asked.add(key);
    try {
      const stream = new Blob([await this.page.part(key)]).stream().pipeThrough(new DecompressionStream("deflate"));
      this.cells.set(key, new Uint8Array(await new Response(stream).arrayBuffer()));
      for (const old of [...this.cells.keys()].slice(0, -3)) this.cells.delete(old);
      this.draw();
    } catch { /* the next update asks again */ } finally { this.asked.delete(key); }
  }

  // ── where it looks ──────────────────────────────────────────────────────────────────────────────────────────────

  private fit(): void {
    const x: number[] = [], y: number[] = [];
    const { grid, robot, goals = [], paths = [] } = this.around;
    const add = (px: number, py: number) => { if (Math.abs(px) < 1e5 && Math.abs(py) < 1e5) { x.push(px); y.push(py); } };
    if (grid) for (const [u, v] of this.known(grid)) {
      const [cos, sin] = [Math.cos(grid.yaw), Math.sin(grid.yaw)];
      add(grid.x + cos * u - sin * v, grid.y + sin * u + cos * v);
    }
    if (robot) add(robot.x, robot.y);
    for (const limb of this.around.limbs ?? []) for (const [px, py] of limb.outline) add(px, py);
    for (const goal of goals) add(goal.x, goal.y);
    for (const path of paths) for (const [px, py] of path.points) add(px, py);
    if (!grid) for (const scan of this.scans) for (let at = 0; at < scan.length; at += 8) add(scan[at] ?? 0, scan[at + 1] ?? 0);
    if (x.length === 0) return;
    const low = [Math.min(...x), Math.min(...y)] as const, high = [Math.max(...x), Math.max(...y)] as const;
    this.centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    const room = 28;
    this.scale = Math.min((this.sheet.width - 2 * room) / Math.max(high[0] - low[0], 2), (this.sheet.height - 2 * room) / Math.max(high[1] - low[1], 2));
  }

  /** The corners of the part of a grid that is known. */
  private known(grid: Grid): [number, number][] {
    const cells = this.cells.get(grid.key);
    let [left, right, low, high] = [0, grid.width, 0, grid.height];
    if (cells) {
      [left, right, low, high] = [grid.width, 0, grid.height, 0];
      for (let row = 0; row < grid.height; row++) for (let column = 0; column < grid.width; column++) if (cells[row * grid.width + column] !== 255) {
        left = Math.min(left, column); right = Math.max(right, column + 1); low = Math.min(low, row); high = Math.max(high, row + 1);
      }
      if (right <= left) [left, right, low, high] = [0, grid.width, 0, grid.height];
    }
    const metres = grid.resolution;
    return [[left * metres, low * metres], [right * metres, low * metres], [left * metres, high * metres], [right * metres, high * metres]];
  }

  private move(dx: number, dy: number): void {
    this.fitted = false;
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.draw();
  }

  private zoom(by: number, x = this.sheet.width / 2, y = this.sheet.height / 2): void {
    const before = this.toMetres(x, y);
    this.fitted = false;
    this.scale = Math.min(2000, Math.max(0.05, this.scale * by));
    const after = this.toMetres(x, y);
    this.centre = [this.centre[0] + before[0] - after[0], this.centre[1] + before[1] - after[1]];
    this.draw();
  }

  private press(event: KeyboardEvent): void {
    const steps: Record<string, () => void> = {
      "+": () => this.zoom(1.25), "=": () => this.zoom(1.25), "-": () => this.zoom(0.8),
      "0": () => { this.fitted = true; this.draw(); },
      Enter: () => this.pick(...this.toMetres(this.sheet.width / 2, this.sheet.height / 2), event.shiftKey),
      ArrowLeft: () => this.move(40, 0), ArrowRight: () => this.move(-40, 0), ArrowUp: () => this.move(0, 40), ArrowDown: () => this.move(0, -40),
    };
    const step = steps[event.key];
    if (step && !event.ctrlKey && !event.metaKey) { event.preventDefault(); step(); }
  }

  private toMetres(x: number, y: number): [number, number] {
    return [this.centre[0] + (x - this.sheet.width / 2) / this.scale, this.centre[1] - (y - this.sheet.height / 2) / this.scale];
  }

  private px = (x: number): number => this.sheet.width / 2 + (x - this.centre[0]) * this.scale;
  private py = (y: number): number => this.sheet.height / 2 - (y - this.centre[1]) * this.scale;

  // ── drawing ─────────────────────────────────────────────────────────────────────────────────────────────────────

  mark(): void {
    this.draw();
  }

  private draw(): void {
    const { pen } = this.sheet;
    this.sheet.clear();
    if (this.fitted && this.sheet.width > 0) this.fit();
    if (this.scale <= 0) return;
    const isDark = document.documentElement.dataset.theme === "dark";
    if (this.around.grid) this.drawGrid(this.around.grid, isDark);
    this.drawLines(isDark);
    pen.lineJoin = pen.lineCap = "round";
    if (this.hasLeft()) this.line(this.trail, isDark ? "#ffb45488" : "#c2600088", 2);
    const paths = isDark ? ["#4cc38a", "#3fb8c4", "#b3c24a"] : ["#0a8a4a", "#007f8c", "#6d7f00"];
    (this.around.paths ?? []).forEach((path, index) => this.line(path.points, paths[index % 3] ?? "", 3));
    pen.fillStyle = isDark ? "#ff6f91" : "#d6003a";
    for (const scan of this.scans) for (let at = 0; at + 1 < scan.length; at += 2) {
      const x = this.px(scan[at] ?? 0), y = this.py(scan[at + 1] ?? 0);
      if (x > 0 && y > 0 && x < this.sheet.width && y < this.sheet.height) pen.fillRect(x - 1.25, y - 1.25, 2.5, 2.5);
    }
    for (const mark of this.around.places ?? []) this.drawMark(mark, isDark ? "#7cb2ff" : "#0050c8", true);
    for (const mark of this.around.goals ?? []) this.drawMark(mark, isDark ? "#ea8bf0" : "#a800a8", false);
    this.drawRobot(isDark);
    for (const limb of this.around.limbs ?? []) this.drawLimb(limb, isDark);
    for (const { one, label } of this.page.picks.of("place")) if (one.frame === this.around.frame) this.drawPick(one.x, one.y, label);
    for (const { one, label } of this.page.picks.of("point")) if (one.in_frame === this.around.frame) this.drawPick(one.in[0] ?? 0, one.in[1] ?? 0, label);
    if (this.sheet.canvas.matches(":focus-visible")) this.drawCross(this.sheet.width / 2, this.sheet.height / 2, 8, colour("accent"));
    this.drawScale();
  }

  /** Whether its trail leads out of its body: a shorter one is how its place trembles. */
  private hasLeft(): boolean {
    const at = this.around.robot, body = this.around.footprint ?? [];
    const reach = at ? Math.max(0.1, ...body.map(([x, y]) => Math.hypot(x - at.x, y - at.y))) : 0;
    return !!at && this.trail.some(([x, y]) => Math.hypot(x - at.x, y - at.y) > reach);
  }

  private drawPick(atX: number, atY: number, label: string): void {
    const { pen } = this.sheet, x = this.px(atX), y = this.py(atY);
    for (const [stroke, width] of [[colour("panel"), 5], [colour("accent"), 2.5]] as const) {
      pen.strokeStyle = stroke;
      pen.lineWidth = width;
      pen.beginPath();
      pen.arc(x, y, 9, 0, 7);
      pen.stroke();
    }
    this.drawCross(x, y, 14, colour("accent"));
    if (!label) return;
    pen.font = "600 12px system-ui, sans-serif";
    pen.fillStyle = colour("accent");
    pen.fillText(label, x + 12, y - 10);
  }

  private drawCross(x: number, y: number, reach: number, stroke: string): void {
    const { pen } = this.sheet;
    pen.strokeStyle = stroke;
    pen.lineWidth = 2;
    pen.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) { pen.moveTo(x + dx * 4, y + dy * 4); pen.lineTo(x + dx * reach, y + dy * reach); }
    pen.stroke();
  }

  private line(points: [number, number][], stroke: string, width: number): void {
    if (points.length < 2) return;
    const { pen } = this.sheet;
    pen.beginPath();
    for (const [x, y] of points) pen.lineTo(this.px(x), this.py(y));
    pen.strokeStyle = stroke;
    pen.lineWidth = width;
    pen.stroke();
  }

  private drawGrid(grid: Grid, isDark: boolean): void {
    const cells = this.cells.get(grid.key);
    if (!cells || cells.length !== grid.width * grid.height) return;
    const key = `${grid.key} ${isDark} ${grid.costs}`;
    if (this.ground?.key !== key) this.ground = { key, canvas: painted(grid, cells, isDark) };
    const { pen, ratio } = this.sheet;
    const side = grid.resolution * this.scale * ratio;
    const [cos, sin] = [Math.cos(grid.yaw), Math.sin(grid.yaw)];
    pen.save();
    pen.imageSmoothingEnabled = side < 1;
    pen.setTransform(side * cos, -side * sin, -side * sin, -side * cos, this.px(grid.x) * ratio, this.py(grid.y) * ratio);
    pen.drawImage(this.ground.canvas, 0, 0);
    pen.restore();
  }

  private drawLines(isDark: boolean): void {
    const { pen, width, height } = this.sheet;
    const metres = this.roundMetres(64);
    pen.lineWidth = 1;
    pen.strokeStyle = isDark ? "#ffffff14" : "#00000012";
    pen.beginPath();
    const [left, top] = this.toMetres(0, 0), [right, bottom] = this.toMetres(width, height);
    for (let x = Math.ceil(left / metres) * metres; x <= right; x += metres) { pen.moveTo(this.px(x), 0); pen.lineTo(this.px(x), height); }
    for (let y = Math.ceil(bottom / metres) * metres; y <= top; y += metres) { pen.moveTo(0, this.py(y)); pen.lineTo(width, this.py(y)); }
    pen.stroke();
  }

  private roundMetres(pixels: number): number {
    const least = pixels / this.scale, digit = 10 ** Math.floor(Math.log10(least));
    return ([1, 2, 5, 10].find((step) => step * digit >= least) ?? 10) * digit;
  }

  private drawScale(): void {
    const { pen, width, height } = this.sheet;
    const metres = this.roundMetres(Math.min(64, width / 10)), long = metres * this.scale;
    pen.font = "12px system-ui, sans-serif";
    const text = this.pointer ? this.toMetres(...this.pointer).map((value) => value.toFixed(2)).join(", ") + " m" : "";
    pen.globalAlpha = 0.8; // a plate, so that no wall is taken for it
    pen.fillStyle = colour("panel");
    pen.fillRect(width - 18 - long, height - 31, long + 12, 27);
    pen.globalAlpha = 1;
    for (const [at, said] of [[width - 12 - long, `${metres} m`], [12, text]] as const) {
      if (!said) continue;
      pen.fillStyle = colour("ink");
      pen.strokeStyle = colour("panel");
      pen.lineWidth = 4;
      pen.strokeText(said, at, height - 16);
      pen.fillText(said, at, height - 16);
    }
    pen.strokeStyle = colour("ink");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(width - 12 - long, height - 9);
    pen.lineTo(width - 12, height - 9);
    pen.stroke();
  }

  private drawMark(mark: Mark, fill: string, square: boolean): void {
    const { pen } = this.sheet;
    const x = this.px(mark.x), y = this.py(mark.y);
    if (x < -50 || y < -50 || x > this.sheet.width + 50 || y > this.sheet.height + 50) return;
    if (mark.yaw !== null) this.arrow(x, y, mark.yaw, 20, fill);
    pen.beginPath();
    if (square) pen.rect(x - 4.5, y - 4.5, 9, 9); else pen.arc(x, y, 6, 0, 7);
    pen.fillStyle = fill;
    pen.strokeStyle = colour("panel");
    pen.lineWidth = 1.5;
    pen.fill();
    pen.stroke();
    const name = mark.name.length > 28 ? `${mark.name.slice(0, 27)}…` : mark.name;
    pen.font = "600 12px system-ui, sans-serif";
    pen.lineWidth = 4;
    const isUp = mark.yaw !== null && Math.sin(mark.yaw) > 0 && Math.cos(mark.yaw) > 0, below = isUp ? y + 18 : y - 7; // beside the arrow
    pen.strokeText(name, x + 9, below);
    pen.fillText(name, x + 9, below);
  }

  private arrow(x: number, y: number, yaw: number, long: number, stroke: string): void {
    const { pen } = this.sheet;
    const at = (turn: number, far: number): [number, number] => [x + far * Math.cos(yaw + turn), y - far * Math.sin(yaw + turn)];
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(...at(0, long));
    const [tipX, tipY] = at(0, long); // a head of the same size on every arrow
    for (const side of [1, -1]) {
      pen.moveTo(tipX, tipY);
      pen.lineTo(tipX - 8 * Math.cos(yaw + side * 0.5), tipY + 8 * Math.sin(yaw + side * 0.5));
    }
    pen.strokeStyle = stroke;
    pen.lineWidth = 2.5;
    pen.stroke();
  }

  private drawRobot(isDark: boolean): void {
    const { pen } = this.sheet, at = this.around.robot;
    if (!at) return;
    const x = this.px(at.x), y = this.py(at.y), body = this.around.footprint;
    let reach = 9;
    pen.beginPath();
    if (body && body.length > 2) {
      for (const [px, py] of body) { pen.lineTo(this.px(px), this.py(py)); reach = Math.max(reach, Math.hypot(this.px(px) - x, this.py(py) - y)); }
      pen.closePath();
    } else pen.arc(x, y, 8, 0, 7);
    pen.fillStyle = `${isDark ? "#ffa63d" : "#ff8c00"}${this.isMoving ? "aa" : "38"}`; // full while it moves
    pen.strokeStyle = isDark ? "#ffb95e" : "#b85c00";
    pen.lineWidth = 2;
    pen.fill();
    pen.stroke();
    this.arrow(x, y, at.yaw, reach + 14, isDark ? "#ffd29a" : "#7a3d00");
  }

  private drawLimb({ outline, bone, jointed }: Limb, isDark: boolean): void {
    const { pen } = this.sheet, stroke = isDark ? "#b9a2f2" : "#5a3296";
    if (outline.length > 2) {
      pen.beginPath();
      for (const [x, y] of outline) pen.lineTo(this.px(x), this.py(y));
      pen.closePath();
      pen.fillStyle = `${stroke}55`;
      pen.strokeStyle = stroke;
      pen.lineWidth = 1.5;
      pen.fill();
      pen.stroke();
    }
    if (!bone) return;
    this.line(bone, stroke, 2);
    if (!jointed) return;
    pen.beginPath();
    pen.arc(this.px(bone[1][0]), this.py(bone[1][1]), 3, 0, 7);
    pen.fillStyle = colour("panel");
    pen.fill();
    pen.stroke();
  }
}

/** The mean of some poses, which trembles less than each. */
function middle(poses: Pose[]): Pose {
  const mean = (of: (pose: Pose) => number): number => poses.reduce((sum, pose) => sum + of(pose), 0) / poses.length;
  return { at: mean((one) => one.at), x: mean((one) => one.x), y: mean((one) => one.y), z: mean((one) => one.z), yaw: Math.atan2(mean((one) => Math.sin(one.yaw)), mean((one) => Math.cos(one.yaw))) };
}

/** A grid as pixels, row 0 below in metres, which the transform turns up. */
function painted(grid: Grid, cells: Uint8Array, isDark: boolean): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.width = grid.width;
  canvas.height = grid.height;
  const pen = canvas.getContext("2d");
  if (!pen) return canvas;
  const image = pen.createImageData(grid.width, grid.height), table = tints(grid.colours ?? "", isDark);
  const pixels = new Uint32Array(image.data.buffer);
  for (let at = 0; at < cells.length; at++) pixels[at] = table[cells[at] ?? 255] ?? 0;
  pen.putImageData(image, 0, 0);
  return canvas;
}

/** The colour of each byte of a cell: 255 is unknown. Costs have those of pictures, which come with the grid (unknown, 0 to 100); in the dark theme unknown and free are dark. */
function tints(colours: string, isDark: boolean): Uint32Array {
  const table = new Uint32Array(256), costs = colours ? bytesOf(colours) : null;
  const free: Tint = isDark ? [35, 45, 42] : [255, 255, 255];
  const full: Tint = isDark ? [148, 162, 156] : [28, 36, 33]; // less bright than the robot and its scan
  const unknown: Tint = isDark ? [22, 29, 27] : [229, 233, 230];
  const mix = (one: Tint, two: Tint, share: number): Tint => [0, 1, 2].map((at) => Math.round((one[at] ?? 0) + ((two[at] ?? 0) - (one[at] ?? 0)) * share)) as Tint;
  const pack = ([red, green, blue]: Tint): number => ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
  for (let value = 0; value < 256; value++) {
    const known = value <= 100, row = known ? 3 * (value + 1) : 0;
    let tint = known ? mix(free, full, value / 100) : unknown;
    if (costs && !(isDark && row <= 3)) tint = [costs[row] ?? 0, costs[row + 1] ?? 0, costs[row + 2] ?? 0];
    table[value] = pack(tint);
  }
  return table;
}

export const kind: Kind = { title: "Map", place: "map", order: 1, folds: true, make: (section, page) => new MapPanel(section, page) };
