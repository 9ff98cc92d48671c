// Draws a tileset with CesiumJS in headless Chromium and writes the picture as PNG.
//
// node cesium.mjs MODULES FOLDER CAMERA.json OUT.png
//   MODULES: a node_modules folder with cesium; FOLDER: with a tileset.json; CAMERA: { width, height, fov_degrees: of the longer side,
//   eye, forward, up: [x, y, z] in the tileset's axes, screen_space_error: the largest of a tile, pixels,
//   still_frames: number of frames for which the picture must stay the same }
//
// Prints the names of the tiles that were drawn, one a line.
import { readFileSync } from 'node:fs';
import { extname, join, normalize } from 'node:path';
import { BEGIN, show } from './browser.mjs';

const [modules, folder, cameraFile, output] = process.argv.slice(2);
const camera = JSON.parse(readFileSync(cameraFile, 'utf8'));

// CesiumJS needs a scene above the ground: east, north and up at latitude and longitude 0 are its y, z and x.
const RADIUS = 6378137;
const tileset = () => {
    const document = JSON.parse(readFileSync(join(folder, 'tileset.json'), 'utf8'));
    document.root.transform = [0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, RADIUS, 0, 0, 1];
    return JSON.stringify(document);
};

const page = `<!DOCTYPE html><meta charset="utf-8"><style>.cesium-widget, .cesium-widget canvas { width: 100%; height: 100%; }</style><div id="c" style="width: ${camera.width}px; height: ${camera.height}px"></div>
<script>window.CESIUM_BASE_URL = '/cesium/';</script>
<script src="/cesium/Cesium.js"></script>
<script type="module">
${BEGIN}
const camera = ${JSON.stringify(camera)};
const widget = new Cesium.CesiumWidget('c', {
    baseLayer: false, globe: false, skyBox: false, skyAtmosphere: false, scene3DOnly: true, useDefaultRenderLoop: false,
    msaaSamples: 1, contextOptions: { webgl: { antialias: false, preserveDrawingBuffer: true } }
});
const scene = widget.scene;
scene.backgroundColor = Cesium.Color.BLACK;
scene.rethrowRenderErrors = true;
for (const body of ['sun', 'moon']) if (scene[body]) scene[body].show = false;
widget.creditDisplay?.container?.remove();
const world = ([x, y, z]) => new Cesium.Cartesian3(z, x, y);
const tiles = await Cesium.Cesium3DTileset.fromUrl('/tiles/tileset.json', {
    maximumScreenSpaceError: camera.screen_space_error, dynamicScreenSpaceError: false, cullRequestsWhileMoving: false
});
tiles.tileFailed.addEventListener((event) => say('/failed', event.url + ': ' + event.message));
scene.primitives.add(tiles);
scene.camera.frustum = new Cesium.PerspectiveFrustum({
    fov: camera.fov_degrees * Math.PI / 180, aspectRatio: camera.width / camera.height, near: 0.1, far: 1e5
});
const drawn = new Set();
tiles.tileVisible.addEventListener((tile) => drawn.add(tile.content.url.split('/').pop()));
// CesiumJS sorts in a worker, and the picture follows some frames later. It has no public sign of that, so private members are read;
// its version is pinned.
const isSettled = () => {
    const splats = tiles.gaussianSplatPrimitive;
    const works = splats._pendingSnapshot || splats._needsSnapshotRebuild || splats._dirty || splats._pendingSortPromise;
    return !works && splats._selectedTileSet.size === drawn.size;
};
// The picture is done when it stays the same.
let last = '', same = 0;
for (let frame = 0; same < camera.still_frames; ++frame) {
    const eye = world(camera.eye);
    eye.x += ${RADIUS};
    scene.camera.setView({ destination: eye, orientation: { direction: world(camera.forward), up: world(camera.up) } });
    drawn.clear();
    widget.resize();
    widget.render();
    await new Promise((resolve) => setTimeout(resolve, 50));
    const now = widget.canvas.toDataURL('image/png');
    same = now === last && tiles.tilesLoaded && drawn.size > 0 && frame > 10 && isSettled() ? same + 1 : 0;
    last = now;
}
await say('/text', [...drawn].join('\\n'));
await say('/done', last);
</script>`;

const types = { '.js': 'text/javascript', '.json': 'application/json', '.wasm': 'application/wasm', '.css': 'text/css' };
const inside = (root, path) => readFileSync(join(root, normalize(path)));
const content = (url) => {
    if (url === '/') return ['text/html', page];
    const type = types[extname(url)] ?? 'application/octet-stream';
    if (url === '/tiles/tileset.json') return [type, tileset()];
    if (url.startsWith('/tiles/')) return [type, inside(folder, url.slice(7))];
    if (url.startsWith('/cesium/')) return [type, inside(join(modules, 'cesium/Build/Cesium'), url.slice(8))];
    throw new Error(url);
};
show(content, output);
