"""A page that shows a tileset: 3d-tiles-renderer and three.js, which the browser fetches."""

from __future__ import annotations

import html
import json
from typing import Final

PAGE: Final = "index.html"
"""The file beside ``tileset.json``."""
PACKAGES: Final = "https://cdn.jsdelivr.net/npm/"
"""Where packages are, by names and versions."""
THREE, RENDERER = "three@0.187.0", "3d-tiles-renderer@0.5.3"


def page(title: str, pixel_error: float, packages: str = PACKAGES) -> bytes:
    """Return the page; tiles are replaced where their errors are more than so many pixels."""
    names = {
        "three": f"{packages}{THREE}/build/three.module.js",
        "three/addons/": f"{packages}{THREE}/examples/jsm/",
        "3d-tiles-renderer/three": f"{packages}{RENDERER}/build/index.three.js",
    }
    text = _PAGE.replace("$TITLE", html.escape(title)).replace("$NAMES", json.dumps({"imports": names}))
    text = text.replace("$DECODER", f"{packages}{THREE}/examples/jsm/libs/basis/")
    return text.replace("$ERROR", f"{pixel_error:g}").encode()


_PAGE: Final = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$TITLE</title>
<style>
  html, body { margin: 0; height: 100%; overflow: hidden; background: #e9e9ec }
  #panel { position: absolute; left: 8px; top: 8px; padding: 6px 10px; background: #fffd }
  #panel { font: 13px/1.5 sans-serif }
  #panel input[type=number] { width: 4em }
</style>
<div id="panel">
  <b>$TITLE</b><br>
  <label>error, pixels <input id="error" type="number" min="0.25" step="any" value="$ERROR"></label><br>
  <label><input id="levels" type="checkbox"> levels</label>
  <label><input id="wires" type="checkbox"> wires</label><br>
  <span id="counts"></span>
</div>
<script type="importmap">$NAMES</script>
<script type="module">
  import * as THREE from "three";
  import { OrbitControls } from "three/addons/controls/OrbitControls.js";
  import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";
  import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
  import { KTX2Loader } from "three/addons/loaders/KTX2Loader.js";
  import { TilesRenderer } from "3d-tiles-renderer/three";

  const element = (name) => document.getElementById(name);
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setClearColor(0xe9e9ec);
  document.body.appendChild(renderer.domElement);
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(50);
  const sun = new THREE.DirectionalLight(0xffffff, 2.5);
  camera.add(sun);
  sun.position.set(-1, 1, 1);
  scene.add(camera, new THREE.HemisphereLight(0xffffff, 0x777788, 1.5));
  const controls = new OrbitControls(camera, renderer.domElement);

  const tiles = new TilesRenderer(new URL("tileset.json", location.href).href);
  const loader = new GLTFLoader(tiles.manager);
  loader.setMeshoptDecoder(MeshoptDecoder);
  loader.setKTX2Loader(new KTX2Loader().setTranscoderPath("$DECODER").detectSupport(renderer));
  tiles.manager.addHandler(/\\.(gltf|glb)$/g, loader);
  tiles.setCamera(camera);
  scene.add(tiles.group);

  // Up is y here, z in a tileset, and away from the centre on the globe.
  const sphere = new THREE.Sphere();
  const place = () => {
    if (!tiles.getBoundingSphere(sphere)) return;
    const onGlobe = sphere.center.length() > 6e6;
    const up = onGlobe ? sphere.center.clone().normalize() : new THREE.Vector3(0, 0, 1);
    tiles.group.quaternion.setFromUnitVectors(up, new THREE.Vector3(0, 1, 0));
    tiles.group.position.copy(sphere.center).applyQuaternion(tiles.group.quaternion).negate();
    const far = sphere.radius / Math.sin(THREE.MathUtils.degToRad(camera.fov / 2));
    camera.position.set(0.5, 0.4, 0.8).setLength(far);
    controls.target.set(0, 0, 0);
    view.placed = true;
  };
  tiles.addEventListener("load-root-tileset", place);

  const colors = ["#444455", "#3366cc", "#22aa99", "#66aa00", "#ddaa00", "#dd6611", "#cc2244", "#994499"];
  const looks = new Map();
  const dress = (mesh, level) => {
    if (!looks.has(mesh)) looks.set(mesh, mesh.material);
    mesh.material = !element("levels").checked ? looks.get(mesh)
      : new THREE.MeshStandardMaterial({ color: colors[level % colors.length], roughness: 0.8 });
    mesh.material.wireframe = element("wires").checked;
  };
  const dressAll = () => tiles.forEachLoadedModel((model, tile) =>
    model.traverse((one) => one.isMesh && dress(one, tile.metadata?.properties?.level ?? 0)));
  tiles.addEventListener("load-model", dressAll);
  for (const name of ["levels", "wires"]) element(name).addEventListener("change", dressAll);

  const resize = () => {
    renderer.setPixelRatio(devicePixelRatio);
    renderer.setSize(innerWidth, innerHeight);
    camera.aspect = innerWidth / innerHeight;
    tiles.setResolutionFromRenderer(camera, renderer);
  };
  addEventListener("resize", resize);
  resize();

  const frame = () => {
    tiles.errorTarget = Number(element("error").value) || 16;
    if (!view.held) controls.update();
    // As near and far as the surface may be.
    const away = camera.position.length();
    camera.near = Math.max((away - 1.1 * sphere.radius) * 0.9, 1e-4 * (sphere.radius || 1));
    camera.far = away + 1.1 * (sphere.radius || 1);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    tiles.update();
    renderer.render(scene, camera);
    const { visible, downloading, parsing } = tiles.stats;
    const drawn = renderer.info.render.triangles.toLocaleString();
    element("counts").textContent = `${visible} tiles, ${drawn} triangles` +
      (downloading + parsing ? `, ${downloading + parsing} to come` : "");
    view.frames += 1;
  };
  // For scripts: what is shown, and whether everything has come.
  const view = window.view = { THREE, renderer, scene, camera, controls, tiles, sphere, frame, frames: 0 };
  renderer.setAnimationLoop(frame);
</script>
</html>
"""
