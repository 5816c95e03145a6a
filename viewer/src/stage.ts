// The 3D scene itself: ground, frames with their axes and names, a cloud, scans, the robot's shapes; z is up.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight, Group, HemisphereLight, LineBasicMaterial, LineSegments,
  Mesh, MeshLambertMaterial, Object3D, PerspectiveCamera, Points, PointsMaterial, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { make, say } from "./dom.ts";
import { type Body, type MeshFacts, lookOf, markerOf } from "./solids.ts";

export type Place = { name: string; parent: string; pose: number[] };
export type Cloud = { count: number; low: number[]; step: number[]; colours: "" | "rgb" | "intensity" };
/** A point that is seen: of the cloud (`scan` is -1) or of a scan, in its own frame and in the one that is shown. */
export type Seen = { scan: number; xyz: number[]; at: number[] };
export type Shape = { link: string; kind: string; size: number[]; xyz: number[]; rpy: number[]; rgba: number[] | null; mesh: MeshFacts | null };

const GROUND_M = 20;
const AXIS_M = 0.25;
const LOOK_M = [-3.2, -3.6, 3.4] as const; // from where a room is seen
const NEAREST = 0.4; // a robot alone is seen from nearer, but not from less than this share of it
const ROOM_M = 1.6; // a robot with frames so far from its base is seen as a room is
const MOST_NAMES = 60;
const FRONT_M = 0.1; // what is farther behind the nearest point is hidden by it
const FRONT_SHARE = 1.03;
const TURN = Math.PI / 24;
const ABOVE = 1, OVER_ALL = 2; // orders of drawing, of groups: after everything else
// Viridis, by eight of its colours: what is higher, or brighter, is lighter, for every eye.
const VIRIDIS = [[68, 1, 84], [70, 50, 127], [54, 92, 141], [39, 127, 142], [31, 161, 135], [74, 194, 109], [159, 218, 58], [253, 231, 37]];

export class Stage {
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(50, 1, 0.02, 3000);
  private readonly controls: OrbitControls;
  private readonly ground: LineSegments;
  private readonly axes = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ vertexColors: true }));
  private readonly ties = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ transparent: true, opacity: 0.6 }));
  private readonly scans = new Points(new BufferGeometry(), new PointsMaterial({ size: 3, sizeAttenuation: false, color: "#d6003a" }));
  private readonly links = new Map<string, Group>();
  private readonly shapeLook = new MeshLambertMaterial({ color: "#ff9f3d" });
  private readonly labels = new Map<string, HTMLElement>();
  private readonly pointLook = new PointsMaterial({ size: 1.7, sizeAttenuation: false, vertexColors: true });
  private readonly ofModel: { dispose(): void }[] = [];
  private readonly ofMarkers: { dispose(): void }[] = [];
  private markers: { at: Group; text: HTMLElement | null }[] = [];
  private points: Points | null = null;
  private cloudXyz = new Float32Array();
  private scanned: { pose: number[]; xy: Float32Array }[] = [];
  private marks: { at: number[]; label: string }[] = [];
  private readonly pins: HTMLElement[] = [];
  private places: Place[] = [];
  private base = "";
  private hasNames = true;
  private follows = true;
  private hasLooked = false;
  private isRoom = true;
  private last: [number, number, number] | null = null;
  private isDirty = false;
  private isDark = false;
  private size: [number, number] = [1, 1];

  /** On a canvas; null where there is no WebGL. */
  static on(canvas: HTMLCanvasElement, names: HTMLElement): Stage | null {
    const trial = document.createElement("canvas");
    const context = trial.getContext("webgl2"); // asked first, as three says it as an error in the console
    if (!context) return null;
    context.getExtension("WEBGL_lose_context")?.loseContext();
    return new Stage(new WebGLRenderer({ canvas, antialias: true }), canvas, names);
  }

  private constructor(private readonly renderer: WebGLRenderer, private readonly canvas: HTMLCanvasElement, private readonly names: HTMLElement) {
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.minDistance = 0.2;
    this.controls.maxDistance = 500;
    this.controls.addEventListener("change", () => this.dirty());
    const lines: Vector3[] = [];
    for (let at = -GROUND_M; at <= GROUND_M; at++) for (let from = -GROUND_M; from < GROUND_M; from++) { // whole lines, of which an end is behind, some drivers drop
      lines.push(new Vector3(at, from), new Vector3(at, from + 1), new Vector3(from, at), new Vector3(from + 1, at));
    }
    this.ground = new LineSegments(new BufferGeometry().setFromPoints(lines), new LineBasicMaterial());
    const sun = new DirectionalLight("#ffffff", 1.6);
    sun.position.set(3, -4, 8);
    this.axes.frustumCulled = this.ties.frustumCulled = this.scans.frustumCulled = false; // they change, and are few
    // The robot is what is looked for: it is drawn over the cloud, of which what stands before it would hide it. So once
    // all else is drawn how deep that lies is forgotten.
    const forget = new Mesh(new BoxGeometry(1, 1, 1), new MeshLambertMaterial({ colorWrite: false, depthWrite: false })), between = new Group();
    forget.frustumCulled = false;
    forget.onBeforeRender = (by) => by.clearDepth();
    between.renderOrder = ABOVE;
    this.scene.add(between.add(forget));
    this.scene.add(this.ground, this.axes, this.ties, this.scans, new HemisphereLight("#ffffff", "#667066", 1.6), sun);
    this.reset();
  }

  // ── what there is ───────────────────────────────────────────────────────────────────────────────────────────────

  /** `isRoom`: more than the robot itself is to be seen. */
  place(places: Place[], base: string, isOther: boolean, isRoom = this.isRoom): void {
    [this.places, this.base, this.isRoom] = [places, base, isRoom];
    const at = new Map(places.map((one) => [one.name, one]));
    const axes: number[] = [], ties: number[] = [];
    for (const { name, parent, pose } of places) {
      const holder = new Object3D();
      put(holder, pose);
      holder.updateMatrixWorld();
      const from = holder.position;
      for (const tip of [new Vector3(AXIS_M, 0, 0), new Vector3(0, AXIS_M, 0), new Vector3(0, 0, AXIS_M)]) {
        const to = tip.applyMatrix4(holder.matrixWorld);
        axes.push(from.x, from.y, from.z, to.x, to.y, to.z);
      }
      const above = at.get(parent)?.pose;
      if (above) ties.push(from.x, from.y, from.z, above[0] ?? 0, above[1] ?? 0, above[2] ?? 0);
      const link = this.links.get(name);
      if (link) { put(link, pose); link.visible = true; }
    }
    for (const [name, link] of this.links) if (!at.has(name)) link.visible = false;
    const tints = this.isDark ? [1, 0.38, 0.4, 0.35, 0.85, 0.4, 0.45, 0.62, 1] : [0.84, 0.07, 0.16, 0.05, 0.55, 0.15, 0.1, 0.25, 0.85];
    const colours = places.flatMap(() => [0, 3, 6].flatMap((from) => [...tints.slice(from, from + 3), ...tints.slice(from, from + 3)]));
    refill(this.axes, axes, colours);
    refill(this.ties, ties);
    this.follow(isOther);
  }

  scan(scans: { pose: number[]; xy: Float32Array }[]): void {
    this.scanned = scans;
    const all: number[] = [];
    for (const { pose, xy } of scans) {
      const holder = new Object3D(), point = new Vector3();
      put(holder, pose);
      holder.updateMatrixWorld();
      for (let at = 0; at + 1 < xy.length; at += 2) {
        point.set(xy[at] ?? 0, xy[at + 1] ?? 0, 0).applyMatrix4(holder.matrixWorld);
        all.push(point.x, point.y, point.z);
      }
    }
    refill(this.scans, all);
  }

  cloud(cloud: Cloud | null, bytes?: Uint8Array<ArrayBuffer>, pose: number[] = []): void {
    if (this.points) { this.scene.remove(this.points); (this.points as unknown as { geometry: BufferGeometry }).geometry.dispose(); this.points = null; }
    this.cloudXyz = new Float32Array();
    if (!cloud || !bytes) return;
    const raw = new Uint16Array(bytes.buffer, 0, cloud.count * 3), xyz = new Float32Array(cloud.count * 3);
    for (let at = 0; at < xyz.length; at++) xyz[at] = (raw[at] ?? 0) * (cloud.step[at % 3] ?? 0) + (cloud.low[at % 3] ?? 0);
    const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(xyz, 3));
    geometry.setAttribute("color", new BufferAttribute(tinted(cloud, bytes, xyz, pose), 3, true));
    this.cloudXyz = xyz;
    this.points = new Points(geometry, this.pointLook);
    put(this.points, pose);
    this.scene.add(this.points);
  }

  moveCloud(pose: number[]): void {
    if (this.points) put(this.points, pose);
  }

  model(shapes: Shape[], meshes: Map<string, BufferGeometry>): void {
    for (const link of this.links.values()) this.scene.remove(link);
    this.links.clear();
    for (const made of this.ofModel.splice(0)) made.dispose();
    for (const shape of shapes) {
      const made = this.shaped(shape, meshes);
      if (!made) continue;
      const link = this.links.get(shape.link) ?? new Group();
      link.renderOrder = OVER_ALL;
      link.add(made);
      if (!this.links.has(shape.link)) { this.links.set(shape.link, link); this.scene.add(link); }
    }
    this.place(this.places, this.base, false);
  }

  /** Draws markers in place of those before; `move` puts each where it belongs. */
  mark3d(bodies: Body[], meshes: Map<string, BufferGeometry>): void {
    for (const { at, text } of this.markers) { this.scene.remove(at); text?.remove(); }
    for (const made of this.ofMarkers.splice(0)) made.dispose();
    this.markers = bodies.map((body) => {
      const at = new Group(), drawn = markerOf(body, meshes, (made) => this.ofMarkers.push(made)), text = body.text === undefined ? null : make("span", { class: "written" }, body.text);
      if (drawn) at.add(drawn);
      if (text) { this.names.append(text); text.style.borderColor = `rgb(${body.rgba.slice(0, 3).map((part) => Math.round(part * 255)).join(" ")})`; }
      this.scene.add(at);
      return { at, text };
    });
  }

  moveMarkers(poses: number[][]): void {
    this.markers.forEach(({ at }, index) => put(at, poses[index] ?? []));
  }

  private write(): void {
    const [width, height] = this.size;
    for (const { at, text } of this.markers) {
      if (!text) continue;
      const seen = at.position.clone().project(this.camera);
      text.hidden = Math.abs(seen.z) > 1 || Math.abs(seen.x) > 1 || Math.abs(seen.y) > 1;
      text.style.transform = `translate(${Math.round(((seen.x + 1) / 2) * width)}px, ${Math.round(((1 - seen.y) / 2) * height - 8)}px) translateX(-50%)`;
    }
  }

  private shaped({ kind, size, xyz, rpy, rgba, mesh: facts }: Shape, meshes: Map<string, BufferGeometry>): Object3D | null {
    const bounded = size.map((value) => Math.min(Math.max(Math.abs(value), 1e-4), 1000)), [one = 0.1, two = 0.1, three = 0.1] = bounded;
    const geometry = kind === "box" ? new BoxGeometry(one, two, three) : kind === "sphere" ? new SphereGeometry(one, 20, 14)
      : kind === "cylinder" ? new CylinderGeometry(one, one, two, 24) : kind === "capsule" ? new CapsuleGeometry(one, two, 6, 18) : meshes.get(facts?.key ?? "");
    if (kind === "outline") return this.outlined(bounded, xyz, rpy);
    if (!geometry) return null;
    const hasOwn = !!facts?.coloured && !rgba, look = rgba || facts ? lookOf(rgba ?? [0.78, 0.78, 0.76, 1], hasOwn) : this.shapeLook;
    if (look !== this.shapeLook) this.ofModel.push(look);
    if (!facts) this.ofModel.push(geometry);
    const mesh = new Mesh(geometry, look), mount = new Group();
    mount.renderOrder = OVER_ALL; // a group's order is not that of those in it
    if (facts) mesh.scale.set(size[0] ?? 1, size[1] ?? 1, size[2] ?? 1);
    if (kind === "cylinder" || kind === "capsule") mesh.rotateX(Math.PI / 2); // theirs stand along y, a URDF's along z
    mount.add(mesh);
    mount.position.set(xyz[0] ?? 0, xyz[1] ?? 0, xyz[2] ?? 0);
    mount.rotation.set(rpy[0] ?? 0, rpy[1] ?? 0, rpy[2] ?? 0, "ZYX");
    return mount;
  }

  /** The edges of a box, where a shape cannot be drawn: something is there. */
  private outlined([x = 0, y = 0, z = 0]: number[], xyz: number[], rpy: number[]): Object3D {
    const corner = (at: number): Vector3 => new Vector3((at & 1 ? x : -x) / 2, (at & 2 ? y : -y) / 2, (at & 4 ? z : -z) / 2);
    const edges = [1, 2, 4].flatMap((way) => [0, 1, 2, 3, 4, 5, 6, 7].filter((at) => !(at & way)).flatMap((at) => [corner(at), corner(at | way)]));
    const geometry = new BufferGeometry().setFromPoints(edges), look = new LineBasicMaterial({ color: "#ff9f3d" }), mount = new Group();
    this.ofModel.push(geometry, look);
    mount.renderOrder = OVER_ALL;
    mount.add(new LineSegments(geometry, look));
    mount.position.set(xyz[0] ?? 0, xyz[1] ?? 0, xyz[2] ?? 0);
    mount.rotation.set(rpy[0] ?? 0, rpy[1] ?? 0, rpy[2] ?? 0, "ZYX");
    return mount;
  }

  /** The graphics have lost all that was on them: it is put there anew with the next picture. */
  drop(): void {
    this.scene.traverse((at) => (at as unknown as { geometry?: BufferGeometry }).geometry?.dispose());
  }

  // ── where it looks ──────────────────────────────────────────────────────────────────────────────────────────────

  private robotAt(): [number, number, number] {
    const pose = this.places.find((one) => one.name === this.base)?.pose;
    return [pose?.[0] ?? 0, pose?.[1] ?? 0, pose?.[2] ?? 0];
  }

  /** Moves with the robot, as far as it moves. */
  private follow(isOther: boolean): void {
    if (!this.places.length) return;
    const at = this.robotAt();
    if (!this.hasLooked || isOther) { this.hasLooked = true; this.reset(); }
    else if (this.follows && this.last) {
      const by = new Vector3(at[0] - this.last[0], at[1] - this.last[1], at[2] - this.last[2]);
      this.camera.position.add(by);
      this.controls.target.add(by);
      this.controls.update();
    }
    this.last = at;
  }

  private reset(): void {
    const [x, y, z] = this.robotAt(), far = Math.max(0, ...this.places.map(({ pose }) => Math.hypot((pose[0] ?? 0) - x, (pose[1] ?? 0) - y, (pose[2] ?? 0) - z)));
    const share = this.isRoom ? 1 : Math.min(Math.max(far / ROOM_M, NEAREST), 1);
    this.controls.target.set(x, y, z + 0.2);
    this.camera.position.set(x + LOOK_M[0] * share, y + LOOK_M[1] * share, z + LOOK_M[2] * share);
    this.controls.update();
    this.dirty();
  }

  /** One key; whether it means something here. */
  press(key: string): boolean {
    const keys: Record<string, () => void> = {
      "0": () => this.reset(), "+": () => this.turn(0, 0, 0.85), "=": () => this.turn(0, 0, 0.85), "-": () => this.turn(0, 0, 1.18),
      ArrowLeft: () => this.turn(-TURN, 0, 1), ArrowRight: () => this.turn(TURN, 0, 1), ArrowUp: () => this.turn(0, TURN, 1), ArrowDown: () => this.turn(0, -TURN, 1),
      f: () => { this.follows = !this.follows; }, n: () => { this.hasNames = !this.hasNames; this.dirty(); },
    };
    const act = keys[key];
    act?.();
    return !!act;
  }

  private turn(around: number, up: number, far: number): void {
    const from = this.camera.position.clone().sub(this.controls.target);
    const flat = Math.hypot(from.x, from.y), reach = Math.hypot(flat, from.z) * far;
    const yaw = Math.atan2(from.y, from.x) + around, pitch = Math.min(Math.max(Math.atan2(from.z, flat) + up, -1.5), 1.5);
    this.camera.position.set(reach * Math.cos(pitch) * Math.cos(yaw), reach * Math.cos(pitch) * Math.sin(yaw), reach * Math.sin(pitch)).add(this.controls.target);
    this.controls.update();
    this.dirty();
  }

  // ── picking ─────────────────────────────────────────────────────────────────────────────────────────────────────

  /** The point that is seen nearest to a place of the canvas, within `reach` pixels; what lies behind others is not. */
  nearest(x: number, y: number, reach: number): Seen | null {
    let found: { off: number; far: number; seen: () => Seen }[] = [];
    let front = Infinity;
    const point = new Vector3(), [width, height] = this.size;
    this.camera.updateMatrixWorld();
    const look = (holder: Object3D, count: number, local: (index: number) => number[], scan: number): void => {
      holder.updateMatrixWorld();
      for (let index = 0; index < count; index++) {
        const [px = 0, py = 0, pz = 0] = local(index);
        point.set(px, py, pz).applyMatrix4(holder.matrixWorld);
        const far = point.distanceTo(this.camera.position), at = [point.x, point.y, point.z];
        point.project(this.camera);
        const off = Math.hypot(((point.x + 1) / 2) * width - x, ((1 - point.y) / 2) * height - y);
        if (!(off <= reach) || Math.abs(point.z) > 1) continue;
        front = Math.min(front, far);
        found.push({ off, far, seen: () => ({ scan, xyz: local(index), at }) });
      }
    };
    const xyz = this.cloudXyz;
    if (this.points) look(this.points, xyz.length / 3, (index) => [xyz[index * 3] ?? 0, xyz[index * 3 + 1] ?? 0, xyz[index * 3 + 2] ?? 0], -1);
    this.scanned.forEach(({ pose, xy }, scan) => {
      const holder = new Object3D();
      put(holder, pose);
      look(holder, Math.floor(xy.length / 2), (index) => [xy[index * 2] ?? 0, xy[index * 2 + 1] ?? 0, 0], scan);
    });
    found = found.filter(({ far }) => far <= front * FRONT_SHARE + FRONT_M).sort((one, other) => one.off - other.off);
    return found[0]?.seen() ?? null;
  }

  /** Marks places in the frame that is shown. */
  mark(marks: { at: number[]; label: string }[]): void {
    this.marks = marks;
    while (this.pins.length < marks.length) { const pin = make("b", { class: "pin" }); this.pins.push(pin); this.names.append(pin); }
    this.dirty();
  }

  private pin(): void {
    const [width, height] = this.size;
    this.pins.forEach((pin, index) => {
      const mark = this.marks[index], at = mark && new Vector3(mark.at[0], mark.at[1], mark.at[2]).project(this.camera);
      pin.hidden = !at || Math.abs(at.z) > 1;
      if (!mark || !at) return;
      say(pin, mark.label);
      pin.style.transform = `translate(${Math.round(((at.x + 1) / 2) * width - 8)}px, ${Math.round(((1 - at.y) / 2) * height - 8)}px)`;
    });
  }

  // ── drawing ─────────────────────────────────────────────────────────────────────────────────────────────────────

  resize(width: number, height: number): void {
    if (width < 2 || height < 2) return;
    this.size = [width, height];
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty();
  }

  paint(back: string, line: string, soft: string, isDark: boolean): void {
    this.renderer.setClearColor(back, 1);
    recolour(this.ground, line);
    recolour(this.ties, soft);
    recolour(this.scans, isDark ? "#ff6f91" : "#d6003a");
    this.pointLook.color = new Color(isDark ? "#c4c4c4" : "#909090"); // times their own: white is seen on a light ground, too, and the cloud is behind the robot
    this.isDark = isDark;
    this.place(this.places, this.base, false);
    this.dirty();
  }

  /** Draws with the next picture of the screen, if it is seen. */
  dirty(): void {
    if (this.isDirty) return;
    this.isDirty = true;
    requestAnimationFrame(() => {
      this.isDirty = false;
      if (!this.canvas.clientWidth) return;
      this.renderer.render(this.scene, this.camera);
      this.label();
      this.pin();
      this.write();
    });
  }

  /** Names at the frames; where they would lie on each other, the first one. */
  private label(): void {
    const shown = new Set<string>(), taken: [number, number][] = [], [width, height] = this.size;
    for (const { name, pose } of this.hasNames ? this.places.slice(0, MOST_NAMES) : []) {
      const at = new Vector3(pose[0] ?? 0, pose[1] ?? 0, pose[2] ?? 0).project(this.camera);
      const x = ((at.x + 1) / 2) * width, y = ((1 - at.y) / 2) * height;
      if (at.z > 1 || x < 0 || y < 0 || x > width || y > height || taken.some(([left, top]) => Math.abs(top - y) < 14 && Math.abs(left - x) < 90)) continue;
      taken.push([x, y]);
      shown.add(name);
      let label = this.labels.get(name);
      if (!label) { label = make("span"); this.labels.set(name, label); this.names.append(label); }
      say(label, name);
      label.hidden = false;
      label.style.transform = `translate(${Math.round(x + 5)}px, ${Math.round(y - 8)}px)`;
    }
    for (const [name, label] of this.labels) if (!shown.has(name)) label.hidden = true;
    if (this.labels.size > 4 * MOST_NAMES) { this.labels.clear(); this.names.replaceChildren(...this.pins, ...this.markers.flatMap(({ text }) => text ?? [])); }
  }
}

function put(at: Object3D, pose: number[]): void {
  at.position.set(pose[0] ?? 0, pose[1] ?? 0, pose[2] ?? 0);
  at.quaternion.set(pose[3] ?? 0, pose[4] ?? 0, pose[5] ?? 0, pose[6] ?? 1);
}

function refill(at: Object3D, xyz: number[], colours?: number[]): void {
  const drawn = at as unknown as { geometry: BufferGeometry };
  drawn.geometry.dispose();
  drawn.geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(xyz), 3));
  if (colours) drawn.geometry.setAttribute("color", new BufferAttribute(new Float32Array(colours), 3));
}

function recolour(at: Object3D, tint: string): void {
  (at as unknown as { material: LineBasicMaterial }).material.color = new Color(tint);
}

/** The colours of a cloud: its own, or how bright or how high each point is. */
function tinted(cloud: Cloud, bytes: Uint8Array, xyz: Float32Array, pose: number[]): Uint8Array {
  const own = bytes.subarray(cloud.count * 6);
  if (cloud.colours === "rgb" && own.length >= cloud.count * 3) return own.slice(0, cloud.count * 3);
  const tints = new Uint8Array(cloud.count * 3);
  const shares = cloud.colours === "intensity" && own.length >= cloud.count ? (at: number): number => (own[at] ?? 0) / 255 : heights(xyz, pose);
  for (let at = 0; at < cloud.count; at++) {
    const share = Math.min(Math.max(shares(at), 0), 1) * (VIRIDIS.length - 1), low = Math.min(Math.floor(share), VIRIDIS.length - 2);
    for (let part = 0; part < 3; part++) tints[at * 3 + part] = (VIRIDIS[low]?.[part] ?? 0) + ((VIRIDIS[low + 1]?.[part] ?? 0) - (VIRIDIS[low]?.[part] ?? 0)) * (share - low);
  }
  return tints;
}

/** How high each point is above the ground, from the lowest twentieth to the highest. */
function heights(xyz: Float32Array, pose: number[]): (at: number) => number {
  const [x = 0, y = 0, z = 0, w = 1] = pose.slice(3);
  const up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
  const height = (at: number): number => (xyz[at * 3] ?? 0) * (up[0] ?? 0) + (xyz[at * 3 + 1] ?? 0) * (up[1] ?? 0) + (xyz[at * 3 + 2] ?? 0) * (up[2] ?? 0);
  const some = Array.from({ length: Math.min(2000, xyz.length / 3) }, (_, at) => height(Math.floor((at * xyz.length) / 3 / Math.min(2000, xyz.length / 3)))).sort((a, b) => a - b);
  const low = some[Math.floor(some.length * 0.05)] ?? 0, high = some[Math.floor(some.length * 0.95)] ?? 1;
  return (at) => (height(at) - low) / Math.max(high - low, 1e-6);
}
