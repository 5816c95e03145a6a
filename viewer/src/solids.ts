// Meshes of files and markers (visualization_msgs) as three draws them.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, CylinderGeometry, Group, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshLambertMaterial,
  Object3D, Points, PointsMaterial, Quaternion, SphereGeometry, Vector3,
} from "three";
import { bytesOf } from "./dom.ts";

/** What is to be known of a mesh whose bytes are asked for by the key. */
export type MeshFacts = { key: string; vertices: number; triangles: number; low: number[]; step: number[]; coloured: boolean };
export type Body = { kind: number; scale: number[]; rgba: number[]; points?: string; colours?: string; text?: string; mesh?: MeshFacts | null; own?: boolean };

const IN_METRES = 1 / Math.tan((25 * Math.PI) / 180); // three's points are so much smaller than their size, at an opening of 50 degrees
const HEAD = 0.23; // of an arrow's length, as RViz draws it
const UP = new Vector3(0, 0, 1);

/** A mesh of its packed bytes; null where these are none. */
export function meshOf(facts: MeshFacts, bytes: Uint8Array<ArrayBuffer>): BufferGeometry | null {
  const { vertices, triangles, low, step, coloured } = facts, corners = triangles * 12, places = corners + vertices * 6;
  if (!(vertices > 0 && triangles > 0) || bytes.length < places + (coloured ? vertices * 3 : 0)) return null;
  const index = new Uint32Array(bytes.buffer.slice(0, corners)), raw = new Uint16Array(bytes.buffer.slice(corners, places)), xyz = new Float32Array(vertices * 3);
  if (index.some((at) => at >= vertices)) return null;
  for (let at = 0; at < xyz.length; at++) xyz[at] = (raw[at] ?? 0) * (step[at % 3] ?? 0) + (low[at % 3] ?? 0);
  const made = new BufferGeometry().setAttribute("position", new BufferAttribute(xyz, 3)).setIndex(new BufferAttribute(index, 1));
  if (coloured) made.setAttribute("color", new BufferAttribute(bytes.slice(places, places + vertices * 3), 3, true));
  return made;
}

/** How a surface looks: its own colours, or one. */
export function lookOf(rgba: number[], hasOwn: boolean): MeshLambertMaterial {
  const [red = 1, green = 1, blue = 1, alpha = 1] = rgba;
  const look = new MeshLambertMaterial({ flatShading: true, side: 2, vertexColors: hasOwn, transparent: alpha < 1, opacity: alpha });
  if (!hasOwn) look.color = new Color().setRGB(red, green, blue, "srgb");
  return look;
}

const CUBE = new BoxGeometry(1, 1, 1), BALL = new SphereGeometry(0.5, 20, 14), SMALL_BALL = new SphereGeometry(0.5, 8, 6);
const TUBE = new CylinderGeometry(0.5, 0.5, 1, 24).rotateX(Math.PI / 2), CONE = new CylinderGeometry(0, 0.5, 1, 20).rotateX(Math.PI / 2);

/** A marker in its own frame; null where there is nothing to draw. `hold` is told of what is to be disposed of. */
export function markerOf(body: Body, meshes: Map<string, BufferGeometry>, hold: (made: { dispose(): void }) => void): Object3D | null {
  const { kind, rgba, scale } = body, [x = 1, y = 1, z = 1] = scale;
  const points = body.points === undefined ? [] : placesOf(body.points);
  const look = (hasOwn = false): MeshLambertMaterial => { const made = lookOf(rgba, hasOwn); hold(made); return made; };
  if (kind >= 1 && kind <= 3) return sized(new Mesh(kind === 1 ? CUBE : kind === 2 ? BALL : TUBE, look()), x, y, z);
  if (kind === 0) {
    const [from, to] = points;
    if (from && to) return arrow(from, to, x, y, z, look());
    return arrow(new Vector3(), new Vector3(x, 0, 0), y, 2 * y, HEAD * x, look());
  }
  if (kind === 12) {
    const all = new Group(), surface = look();
    points.slice(1).forEach((to, at) => all.add(arrow(points[at] ?? to, to, x, y, z, surface)));
    return all;
  }
  if (kind === 10) {
    const mesh = body.mesh ? meshes.get(body.mesh.key) : undefined;
    return mesh && body.mesh ? sized(new Mesh(mesh, look(body.mesh.coloured && body.own === true)), x, y, z) : null;
  }
  if (!points.length) return null;
  if (kind === 6 || kind === 7) return many(kind === 6 ? CUBE : SMALL_BALL, points, body, look(false), hold);
  const xyz = kind === 4 ? points.slice(1).flatMap((to, at) => [points[at] ?? to, to]) : points;
  const made = new BufferGeometry().setFromPoints(xyz);
  hold(made);
  const tints = body.colours === undefined ? null : tintsOf(body.colours, points.length, kind === 4);
  if (tints) made.setAttribute("color", new BufferAttribute(tints, 3, true));
  if (kind === 11) return new Mesh(made, look(!!tints));
  const [red = 1, green = 1, blue = 1, alpha = 1] = rgba, drawn = { vertexColors: !!tints, transparent: alpha < 1, opacity: alpha };
  const stroke = kind === 8 ? new PointsMaterial({ ...drawn, size: Math.max(x, 1e-3) * IN_METRES, sizeAttenuation: true }) : new LineBasicMaterial(drawn);
  if (!tints) stroke.color = new Color().setRGB(red, green, blue, "srgb");
  hold(stroke);
  return kind === 8 ? new Points(made, stroke) : new LineSegments(made, stroke);
}

function sized(mesh: Mesh, x: number, y: number, z: number): Object3D {
  mesh.scale.set(x, y, z);
  return new Group().add(mesh);
}

function arrow(from: Vector3, to: Vector3, shaft: number, head: number, headLong: number, look: MeshLambertMaterial): Object3D {
  const all = new Group(), way = to.clone().sub(from), long = way.length(), tip = Math.min(headLong > 0 ? headLong : HEAD * long, long);
  const body = new Mesh(TUBE, look), point = new Mesh(CONE, look);
  body.scale.set(shaft, shaft, Math.max(long - tip, 1e-6));
  body.position.set(0, 0, (long - tip) / 2);
  point.scale.set(head, head, Math.max(tip, 1e-6));
  point.position.set(0, 0, long - tip / 2);
  all.add(body, point);
  all.position.copy(from);
  if (long > 1e-9) all.quaternion.copy(new Quaternion().setFromUnitVectors(UP, way.normalize()));
  return all;
}

function many(geometry: BufferGeometry, points: Vector3[], body: Body, look: MeshLambertMaterial, hold: (made: { dispose(): void }) => void): Object3D {
  const [x = 1, y = 1, z = 1] = body.scale, all = new InstancedMesh(geometry, look, points.length), tints = body.colours === undefined ? null : bytesOf(body.colours);
  const turn = new Quaternion(), size = new Vector3(x, y, z);
  points.forEach((at, index) => {
    all.setMatrixAt(index, new Matrix4().compose(at, turn, size));
    if (tints) all.setColorAt(index, new Color().setRGB((tints[index * 3] ?? 0) / 255, (tints[index * 3 + 1] ?? 0) / 255, (tints[index * 3 + 2] ?? 0) / 255, "srgb"));
  });
  if (tints) look.color = new Color("#ffffff");
  hold(all);
  return all;
}

function placesOf(text: string): Vector3[] {
  const bytes = bytesOf(text), xyz = new Float32Array(bytes.buffer, 0, Math.floor(bytes.length / 12) * 3);
  return Array.from({ length: xyz.length / 3 }, (_, at) => new Vector3(xyz[at * 3], xyz[at * 3 + 1], xyz[at * 3 + 2]));
}

/** Three bytes for each point; `isStrip`: for both ends of each piece of a line. */
function tintsOf(text: string, count: number, isStrip: boolean): Uint8Array | null {
  const tints = bytesOf(text);
  if (tints.length < count * 3) return null;
  if (!isStrip) return tints.slice(0, count * 3);
  const both = new Uint8Array((count - 1) * 6);
  for (let at = 0; at < count - 1; at++) both.set(tints.subarray(at * 3, at * 3 + 6), at * 6);
  return both;
}
