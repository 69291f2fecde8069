// The 3D views: one WebGL canvas, one camera, a scissor rectangle per view.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import type { Comparison, MapKind } from "./comparison";
import type { Cloths, Obstacle } from "./data";
import { Curvature, maximum, rms, roundUp, vertexNormals } from "./geometry";
import { clothMaterial, mapMaterial } from "./materials";

export type ViewName = "coarse" | "enhanced" | "reference" | "map";

const kFieldOfView = 30;
/** Pixels at the top of a view of this height that its caption covers. */
const captionOf = (height: number): number => Math.min(54, height / 4);
/** And what the choice of the map takes below. */
const footOf = (height: number): number => Math.min(44, height / 7);

/** A cloth mesh whose arrays are rewritten per frame. */
class Cloth {
  readonly geometry = new THREE.BufferGeometry();
  readonly positions: Float32Array;
  readonly values: Float32Array;
  readonly mesh: THREE.Mesh;
  readonly wire: THREE.LineSegments;
  private readonly normals: Float32Array;
  private readonly curvatures: Float32Array;
  private readonly curvature: Curvature;

  constructor(
    private readonly faces: Uint32Array,
    vertices: number,
    material: THREE.Material,
  ) {
    this.positions = new Float32Array(3 * vertices);
    this.normals = new Float32Array(3 * vertices);
    this.curvatures = new Float32Array(vertices);
    this.values = new Float32Array(vertices);
    this.curvature = new Curvature(faces, vertices);
    const dynamic = (array: Float32Array, size: number) => new THREE.BufferAttribute(array, size).setUsage(THREE.DynamicDrawUsage);
    this.geometry.setIndex(new THREE.BufferAttribute(faces, 1));
    this.geometry.setAttribute("position", dynamic(this.positions, 3));
    this.geometry.setAttribute("normal", dynamic(this.normals, 3));
    this.geometry.setAttribute("curvature", dynamic(this.curvatures, 1));
    this.geometry.setAttribute("value", dynamic(this.values, 1));
    this.mesh = new THREE.Mesh(this.geometry, material);
    this.mesh.castShadow = true;
    this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    const lines = new THREE.BufferGeometry();
    lines.setAttribute("position", this.geometry.getAttribute("position"));
    lines.setIndex(new THREE.BufferAttribute(edgesOf(faces, vertices), 1));
    this.wire = new THREE.LineSegments(lines, new THREE.LineBasicMaterial({ color: 0x1b1412, transparent: true, opacity: 0.55 }));
    this.wire.frustumCulled = false;
    this.wire.visible = false;
  }

  update(): void {
    vertexNormals(this.positions, this.faces, this.normals);
    this.curvature.compute(this.positions, this.normals, this.curvatures);
    for (const name of ["position", "normal", "curvature", "value"]) this.geometry.getAttribute(name).needsUpdate = true;
  }
}

function edgesOf(faces: Uint32Array, vertices: number): Uint32Array {
  const seen = new Set<number>();
  for (let f = 0; f < faces.length; f += 3) {
    for (let k = 0; k < 3; ++k) {
      const a = faces[f + k];
      const b = faces[f + ((k + 1) % 3)];
      seen.add(Math.min(a, b) * vertices + Math.max(a, b));
    }
  }
  const edges = new Uint32Array(2 * seen.size);
  let i = 0;
  for (const key of seen) {
    edges[i++] = Math.floor(key / vertices);
    edges[i++] = key % vertices;
  }
  return edges;
}

/** An obstacle in one scene. */
class ObstacleMesh {
  readonly mesh: THREE.Mesh;
  private readonly positions?: Float32Array;

  constructor(
    private readonly obstacle: Obstacle,
    material: THREE.Material,
  ) {
    let geometry: THREE.BufferGeometry;
    if (obstacle.mesh && obstacle.faces) {
      geometry = new THREE.BufferGeometry();
      this.positions = new Float32Array(3 * obstacle.mesh.vertices);
      geometry.setAttribute("position", new THREE.BufferAttribute(this.positions, 3).setUsage(THREE.DynamicDrawUsage));
      geometry.setIndex(new THREE.BufferAttribute(obstacle.faces, 1));
    } else {
      geometry = new THREE.SphereGeometry(1, 96, 64);
    }
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.castShadow = true;
    this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
  }

  update(frame: number): void {
    if (this.positions) {
      this.obstacle.mesh!.positions(frame, this.positions);
      this.mesh.geometry.getAttribute("position").needsUpdate = true;
      this.mesh.geometry.computeVertexNormals();
    } else {
      const { center, radius } = this.obstacle.sphere?.(frame) ?? { center: [0, 0, 0], radius: 0 };
      this.mesh.position.fromArray(Array.from(center));
      this.mesh.scale.setScalar(Math.max(radius, 1e-6));
    }
  }
}

/** One panel: its scene, lights and cloth. */
class View {
  readonly scene = new THREE.Scene();
  readonly key = new THREE.DirectionalLight(0xfff4e8, 2.0);
  readonly rim = new THREE.DirectionalLight(0xbcd4ff, 0.7);
  private readonly obstacles: ObstacleMesh[];

  constructor(
    readonly name: ViewName,
    readonly panel: HTMLElement,
    readonly cloth: Cloth,
    obstacles: Obstacle[],
    obstacleMaterial: THREE.Material,
    environment: THREE.Texture | null,
    private ground: THREE.Object3D,
  ) {
    this.obstacles = obstacles.map((o) => new ObstacleMesh(o, obstacleMaterial));
    if (environment) {
      this.scene.environment = environment;
      this.scene.environmentIntensity = 0.7;
    } else {
      this.scene.add(new THREE.HemisphereLight(0xffffff, 0xa79c92, 2.2));
    }
    this.key.castShadow = true;
    this.key.shadow.mapSize.setScalar(environment ? 2048 : 512);
    this.key.shadow.autoUpdate = false;
    this.key.shadow.bias = -0.0004;
    this.key.shadow.normalBias = 0.006;
    this.key.shadow.radius = 3;
    this.scene.add(this.key, this.key.target, this.rim, this.rim.target, cloth.mesh, cloth.wire, ground, ...this.obstacles.map((o) => o.mesh));
  }

  setGround(ground: THREE.Object3D): void {
    this.scene.remove(this.ground);
    this.scene.add(ground);
    this.ground = ground;
  }

  setFrame(frame: number): void {
    this.cloth.update();
    for (const obstacle of this.obstacles) obstacle.update(frame);
    this.key.shadow.needsUpdate = true;
  }
}

/** Soft shadow and rings on the floor, fading outwards. */
function makeGround(height: number, center: THREE.Vector3, radius: number, material: THREE.ShaderMaterial): THREE.Group {
  const group = new THREE.Group();
  const shadow = new THREE.Mesh(new THREE.CircleGeometry(6 * radius, 96), new THREE.ShadowMaterial({ opacity: 0.22 }));
  const rings = new THREE.Mesh(new THREE.CircleGeometry(3.2 * radius, 96), material);
  for (const disk of [shadow, rings]) {
    disk.rotation.x = -Math.PI / 2;
    disk.position.set(center.x, height, center.z);
    group.add(disk);
  }
  shadow.receiveShadow = true;
  rings.position.y -= 0.001 * radius;
  return group;
}

function groundMaterial(radius: number): THREE.ShaderMaterial {
  return new THREE.ShaderMaterial({
    transparent: true,
    depthWrite: false,
    uniforms: { uColor: { value: new THREE.Color(0x888888) }, uRadius: { value: 3.2 * radius }, uCell: { value: roundUp(radius / 8) } },
    vertexShader: "varying vec2 vPlace; void main() { vPlace = position.xy; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
    fragmentShader: `uniform vec3 uColor; uniform float uRadius; uniform float uCell; varying vec2 vPlace;
      void main() {
        vec2 cell = vPlace / uCell;
        vec2 line = abs(fract(cell - 0.5) - 0.5) / fwidth(cell);
        float ink = 1.0 - min(min(line.x, line.y), 1.0);
        float fade = smoothstep(1.0, 0.2, length(vPlace) / uRadius);
        gl_FragColor = vec4(uColor, ink * fade * 0.22);
      }`,
  });
}

/** Whether WebGL runs on the processor, as on virtual machines: then light from all around costs too much. */
function drawsInSoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const names = context?.getExtension("WEBGL_debug_renderer_info");
  const renderer = names ? String(context!.getParameter(names.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
}

export class Stage {
  readonly renderer: THREE.WebGLRenderer;
  readonly camera = new THREE.PerspectiveCamera(kFieldOfView, 1, 0.01, 100);
  readonly controls: OrbitControls;
  readonly views: View[] = [];
  mapKind: MapKind | undefined;
  /** Figures of the map in the current frame, metres. */
  mapFigures = { rms: 0, max: 0 };
  private readonly center = new THREE.Vector3();
  private radius = 1;
  /** A sample of the places where cloth is: what the camera must hold. */
  private readonly places: THREE.Vector3[] = [];
  private dirty = true;
  private readonly resized = new ResizeObserver(() => this.invalidate());
  private readonly ringMaterial: THREE.ShaderMaterial;

  constructor(
    private readonly container: HTMLElement,
    canvas: HTMLCanvasElement,
    private readonly data: Cloths,
    private readonly comparison: Comparison | undefined,
    panels: Map<ViewName, HTMLElement>,
  ) {
    const thrifty = !location.hash.includes("best") && drawsInSoftware();
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !thrifty, alpha: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.toneMappingExposure = 1;
    this.renderer.setScissorTest(true);
    const environment = thrifty
      ? null
      : new THREE.PMREMGenerator(this.renderer).fromScene(new RoomEnvironment(), 0.04).texture;

    const floor = this.measure();
    this.ringMaterial = groundMaterial(this.radius);
    const obstacleMaterial = new THREE.MeshStandardMaterial({ color: 0x9aa1ab, roughness: 0.55, metalness: 0.05 });
    const mapObstacleMaterial = new THREE.MeshStandardMaterial({ color: 0xb9bec6, roughness: 0.9 });
    const cloth = clothMaterial();
    for (const [name, panel] of panels) {
      const isCoarse = name === "coarse";
      const mesh = new Cloth(
        isCoarse ? data.coarseFaces : data.fineFaces,
        isCoarse ? data.coarse.vertices : data.enhanced.vertices,
        name === "map" ? mapMaterial() : cloth,
      );
      const ground = makeGround(floor, this.center, this.radius, this.ringMaterial);
      this.views.push(
        new View(name, panel, mesh, data.obstacles, name === "map" ? mapObstacleMaterial : obstacleMaterial, environment, ground),
      );
    }
    this.mapKind = comparison?.kinds[0]?.kind;
    this.controls = new OrbitControls(this.camera, container);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.12;
    this.controls.autoRotateSpeed = 2.4;
    this.controls.addEventListener("change", () => this.invalidate());
    this.resized.observe(container);
  }

  /** Gives back what the graphics card holds; the canvas may be drawn to by another one then. */
  dispose(): void {
    this.resized.disconnect();
    this.controls.dispose();
    for (const { cloth, scene } of this.views) {
      cloth.wire.geometry.dispose();
      scene.traverse((object) => object instanceof THREE.Mesh && (object.geometry as THREE.BufferGeometry).dispose());
    }
    this.renderer.dispose();
  }

  /** Whether the coarse cloth of a frame is where measure() has found it. */
  holds(frame: number): boolean {
    const positions = this.data.coarse.positions(frame, new Float32Array(3 * this.data.coarse.vertices));
    const point = new THREE.Vector3();
    for (let v = 0; v < positions.length; v += 3) {
      point.fromArray(positions, v).sub(this.center);
      if (Math.max(Math.abs(point.x), Math.abs(point.y), Math.abs(point.z)) > this.radius) return false;
    }
    return true;
  }

  /** For frames that came meanwhile. */
  remeasure(): void {
    const floor = this.measure();
    this.ringMaterial.uniforms.uRadius.value = 3.2 * this.radius;
    this.ringMaterial.uniforms.uCell.value = roundUp(this.radius / 8);
    for (const view of this.views) view.setGround(makeGround(floor, this.center, this.radius, this.ringMaterial));
    this.invalidate();
  }

  /** Box of all frames, as centre and half its largest side; returns the height of the floor. */
  private measure(): number {
    const { coarse } = this.data;
    const positions = new Float32Array(3 * coarse.vertices);
    const box = new THREE.Box3();
    const point = new THREE.Vector3();
    const frameStep = Math.ceil(coarse.frames / 24);
    const vertexStep = 3 * Math.ceil(coarse.vertices / 400);
    this.places.length = 0;
    for (let frame = 0; frame < coarse.frames; ++frame) {
      coarse.positions(frame, positions);
      for (let v = 0; v < positions.length; v += 3) box.expandByPoint(point.fromArray(positions, v));
      // The first frames often show a flat sheet, far wider than the motion that follows.
      if (frame % frameStep !== 0 || frame < 0.3 * (coarse.frames - 1)) continue;
      for (let v = 0; v < positions.length; v += vertexStep) this.places.push(new THREE.Vector3().fromArray(positions, v));
    }
    const reach = box.getSize(point).length();
    for (let frame = 0; frame < coarse.frames; ++frame) {
      for (const obstacle of this.data.obstacles) {
        const sphere = obstacle.sphere?.(frame);
        // A sphere far larger than the cloth is scenery.
        if (!sphere || sphere.radius > reach) continue;
        point.fromArray(Array.from(sphere.center));
        box.expandByPoint(point.clone().addScalar(sphere.radius));
        box.expandByPoint(point.subScalar(sphere.radius));
      }
    }
    box.getCenter(this.center);
    const size = box.getSize(point);
    this.radius = Math.max(0.5 * Math.max(size.x, size.y, size.z), 1e-3) * 1.12;
    return box.min.y - 0.02 * this.radius;
  }

  /** Looks from the given angles (radians) at the distance from which the moving cloth fits, divided by zoom. */
  resetCamera(azimuth = 0.55, elevation = 0.3, zoom = 1): void {
    const toEye = new THREE.Vector3(
      Math.sin(azimuth) * Math.cos(elevation),
      Math.sin(elevation),
      Math.cos(azimuth) * Math.cos(elevation),
    );
    const right = new THREE.Vector3(Math.cos(azimuth), 0, -Math.sin(azimuth));
    const up = new THREE.Vector3().crossVectors(toEye, right);
    const panel = this.views.find((view) => view.panel.clientHeight > 0)?.panel;
    const aspect = panel ? Math.max(1, panel.clientWidth / panel.clientHeight) : 1;
    const half = Math.tan((kFieldOfView * Math.PI) / 360);
    const high = panel?.clientHeight ?? 1;
    const free = panel ? 1 - (captionOf(high) + this.foot(high)) / high : 1;
    const target = this.center.clone();
    const offset = new THREE.Vector3();
    let distance = 0;
    // Twice: the first round finds the middle of the picture, which perspective moves.
    for (let round = 0; round < 2; ++round) {
      distance = 0.5 * this.radius;
      for (const place of this.places) {
        offset.subVectors(place, target);
        const across = Math.abs(offset.dot(right)) / aspect;
        const upright = Math.abs(offset.dot(up)) / free;
        distance = Math.max(distance, offset.dot(toEye) + Math.max(across, upright) / half);
      }
      if (round === 1) break;
      let [left, rightmost, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
      for (const place of this.places) {
        offset.subVectors(place, target);
        const depth = distance - offset.dot(toEye);
        left = Math.min(left, offset.dot(right) / depth);
        rightmost = Math.max(rightmost, offset.dot(right) / depth);
        bottom = Math.min(bottom, offset.dot(up) / depth);
        top = Math.max(top, offset.dot(up) / depth);
      }
      target.addScaledVector(right, 0.5 * (left + rightmost) * distance).addScaledVector(up, 0.5 * (bottom + top) * distance);
    }
    distance *= 1.06 / zoom;
    this.controls.target.copy(target);
    this.camera.position.copy(toEye).multiplyScalar(distance).add(target);
    this.camera.near = distance / 100;
    this.camera.far = distance * 20;
    this.camera.updateProjectionMatrix();
    this.controls.minDistance = distance * 0.08;
    this.controls.maxDistance = distance * 4;
    this.controls.update();
    this.invalidate();
  }

  setWireframe(on: boolean): void {
    for (const view of this.views) view.cloth.wire.visible = on;
    this.invalidate();
  }

  setInk(color: string): void {
    (this.ringMaterial.uniforms.uColor.value as THREE.Color).set(color);
    this.invalidate();
  }

  setFrame(frame: number): void {
    const { data, comparison } = this;
    for (const view of this.views) {
      const { cloth } = view;
      if (view.name === "map") {
        if (!this.mapKind || !comparison) continue;
        comparison.compute(this.mapKind, frame, cloth.positions, cloth.values);
        this.mapFigures = { rms: rms(cloth.values), max: maximum(cloth.values) };
        const scale = 1 / (comparison.scale.get(this.mapKind) ?? 1);
        for (let v = 0; v < cloth.values.length; ++v) cloth.values[v] *= scale;
      } else {
        const sequence = view.name === "coarse" ? data.coarse : view.name === "enhanced" ? data.enhanced : data.reference!;
        sequence.positions(frame, cloth.positions);
      }
      view.setFrame(frame);
    }
    this.invalidate();
  }

  invalidate(): void {
    this.dirty = true;
  }

  /** Draws if something changed. Returns whether it drew. */
  draw(): boolean {
    this.controls.update();
    if (!this.dirty) return false;
    this.dirty = false;
    this.render();
    return true;
  }

  /** Draws all visible views. */
  render(): void {
    const { renderer, camera } = this;
    const bounds = this.container.getBoundingClientRect();
    if (bounds.width < 1 || bounds.height < 1) return;
    const ratio = Math.min(window.devicePixelRatio, 2);
    if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
    const size = renderer.getSize(new THREE.Vector2());
    if (size.x !== bounds.width || size.y !== bounds.height) renderer.setSize(bounds.width, bounds.height, false);
    this.aimLights();
    for (const view of this.views) {
      const rectangle = view.panel.getBoundingClientRect();
      if (rectangle.width < 2 || rectangle.height < 2) continue;
      const left = rectangle.left - bounds.left;
      const bottom = bounds.bottom - rectangle.bottom;
      renderer.setViewport(left, bottom, rectangle.width, rectangle.height);
      renderer.setScissor(left, bottom, rectangle.width, rectangle.height);
      // A tall panel sees the same width of cloth as a square one.
      const aspect = rectangle.width / rectangle.height;
      camera.aspect = aspect;
      const half = Math.tan((kFieldOfView * Math.PI) / 360);
      camera.fov = (2 * Math.atan(half / Math.min(1, aspect)) * 180) / Math.PI;
      // The middle of the picture is that of what caption and foot leave free.
      const shift = (this.foot(rectangle.height) - captionOf(rectangle.height)) / 2;
      camera.setViewOffset(rectangle.width, rectangle.height, 0, shift, rectangle.width, rectangle.height);
      renderer.render(view.scene, camera);
    }
    camera.clearViewOffset();
  }

  /** All views stand alike: beside a map they leave its foot free, too. */
  private foot(height: number): number {
    return this.views.some((view) => view.name === "map") ? footOf(height) : 0;
  }

  /** The studio turns with the camera, so that every side is seen in light that grazes the wrinkles. */
  private aimLights(): void {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const azimuth = Math.atan2(offset.x, offset.z) - 0.95;
    const direction = new THREE.Vector3(Math.sin(azimuth) * 0.8, 0.72, Math.cos(azimuth) * 0.8).normalize();
    const reach = 1.6 * this.radius;
    const back = new THREE.Vector3(-direction.x, 0.35, -direction.z).normalize();
    for (const { key, rim } of this.views) {
      rim.position.copy(this.center).addScaledVector(back, 4 * this.radius);
      rim.target.position.copy(this.center);
      const position = this.center.clone().addScaledVector(direction, 4 * this.radius);
      if (!key.position.equals(position)) key.shadow.needsUpdate = true;
      key.position.copy(position);
      key.target.position.copy(this.center);
      const frustum = key.shadow.camera;
      frustum.left = frustum.bottom = -reach;
      frustum.right = frustum.top = reach;
      frustum.near = this.radius;
      frustum.far = 8 * this.radius;
      frustum.updateProjectionMatrix();
    }
  }
}
