// What the page uses of three, which has no declarations of its own.

declare module "three" {
  export class Vector3 {
    x: number; y: number; z: number;
    constructor(x?: number | undefined, y?: number | undefined, z?: number | undefined);
    set(x: number, y: number, z: number): this;
    copy(other: Vector3): this;
    add(other: Vector3): this;
    sub(other: Vector3): this;
    project(camera: PerspectiveCamera): this;
    applyMatrix4(matrix: Matrix4): this;
    distanceTo(other: Vector3): number;
    clone(): Vector3;
    length(): number;
    normalize(): this;
  }
  export class Quaternion { set(x: number, y: number, z: number, w: number): this; copy(other: Quaternion): this; setFromUnitVectors(from: Vector3, to: Vector3): this }
  export class Euler { set(x: number, y: number, z: number, order: string): this }
  export class Matrix4 { compose(at: Vector3, turn: Quaternion, size: Vector3): this }
  export class Color { constructor(colour?: string); setRGB(r: number, g: number, b: number, space: string): this; setHSL(h: number, s: number, l: number): this }
  export class Object3D {
    position: Vector3; quaternion: Quaternion; rotation: Euler; up: Vector3; scale: Vector3; visible: boolean; matrixWorld: Matrix4; children: Object3D[]; renderOrder: number; onBeforeRender: (renderer: WebGLRenderer) => void; frustumCulled: boolean;
    add(...others: Object3D[]): this;
    remove(...others: Object3D[]): this;
    clear(): this;
    updateMatrixWorld(force?: boolean): void;
    traverse(each: (at: Object3D) => void): void;
    rotateX(by: number): this;
  }
  export class Group extends Object3D { }
  export class Scene extends Object3D { background: Color | null }
  export class PerspectiveCamera extends Object3D {
    constructor(fov: number, aspect: number, near: number, far: number);
    aspect: number;
    updateProjectionMatrix(): void;
  }
  export class BufferAttribute { constructor(array: ArrayLike<number>, size: number, normalized?: boolean); needsUpdate: boolean }
  export class BufferGeometry {
    setAttribute(name: string, attribute: BufferAttribute): this;
    setFromPoints(points: Vector3[]): this;
    setIndex(index: BufferAttribute): this;
    rotateX(by: number): this;
    dispose(): void;
  }
  export class BoxGeometry extends BufferGeometry { constructor(x: number, y: number, z: number) }
  export class SphereGeometry extends BufferGeometry { constructor(radius: number, across: number, up: number) }
  export class CylinderGeometry extends BufferGeometry { constructor(top: number, bottom: number, height: number, around: number) }
  export class CapsuleGeometry extends BufferGeometry { constructor(radius: number, length: number, caps: number, around: number) }
  type Look = { color?: string; size?: number; sizeAttenuation?: boolean; vertexColors?: boolean; transparent?: boolean; opacity?: number; depthTest?: boolean; depthWrite?: boolean; colorWrite?: boolean; flatShading?: boolean; side?: number };
  export class Material { color: Color; opacity: number; needsUpdate: boolean; dispose(): void; constructor(look?: Look) }
  export class PointsMaterial extends Material { size: number }
  export class LineBasicMaterial extends Material { }
  export class MeshLambertMaterial extends Material { }
  export class Points extends Object3D { constructor(geometry: BufferGeometry, material: Material) }
  export class LineSegments extends Object3D { constructor(geometry: BufferGeometry, material: Material) }
  export class Mesh extends Object3D { constructor(geometry: BufferGeometry, material: Material) }
  export class InstancedMesh extends Mesh {
    constructor(geometry: BufferGeometry, material: Material, count: number);
    setMatrixAt(index: number, matrix: Matrix4): void;
    setColorAt(index: number, colour: Color): void;
    dispose(): void;
  }
  export class HemisphereLight extends Object3D { constructor(sky: string, ground: string, intensity: number) }
  export class DirectionalLight extends Object3D { constructor(colour: string, intensity: number) }
  export class WebGLRenderer {
    constructor(options: { canvas: HTMLCanvasElement; antialias?: boolean; alpha?: boolean });
    setPixelRatio(ratio: number): void;
    setSize(width: number, height: number, style?: boolean): void;
    clearDepth(): void;
    setClearColor(colour: string, alpha: number): void;
    render(scene: Scene, camera: PerspectiveCamera): void;
  }
}

declare module "three/examples/jsm/controls/OrbitControls.js" {
  import type { Object3D, Vector3 } from "three";
  export class OrbitControls {
    constructor(camera: Object3D, element: HTMLElement);
    target: Vector3;
    enableDamping: boolean;
    maxDistance: number;
    minDistance: number;
    update(): void;
    addEventListener(name: string, heard: () => void): void;
  }
}
