// Draws a file of Gaussians with the PlayCanvas engine in headless Chromium and writes the picture as PNG.
//
// node playcanvas.mjs MODULES SCENE CAMERA.json OUT.png
//   MODULES: a node_modules folder with playcanvas; CAMERA: { width, height, fov_y_degrees, eye: [x, y, z],
//   quat: [x, y, z, w] of the rotation from a camera with y up and z backward to the file's own axes,
//   still_frames: for how many frames the picture must stay the same,
//   reference_dilation: whether to widen splats by 0.3 pixels squared as the reference does. The engine adds 0.3 half pixels
//   squared, a quarter of that, so its small splats are sharper,
//   timed_frames: optional, how many frames are timed once the picture stays the same }
//
// A timed frame is `app.render()` and the reading of its pixels, which waits for them. The engine sorts in a worker when the
// camera moves; here it stands still, so no sort is timed. The median is printed.
import { readFileSync, readdirSync } from 'node:fs';
import { basename, join } from 'node:path';
import { BEGIN, show } from './browser.mjs';

const [modules, scene, cameraFile, output] = process.argv.slice(2);
const camera = JSON.parse(readFileSync(cameraFile, 'utf8'));
const sceneName = basename(scene);

const engine = () => {
    let text = readFileSync(join(modules, 'playcanvas/build/playcanvas.mjs'), 'utf8');
    if (!camera.reference_dilation) return text;
    for (const [name, place] of [['diagonal1', 'cov[0][0]'], ['diagonal2', 'cov[1][1]']]) {
        const own = `float ${name} = ${place} + 0.3;`;
        if (!text.includes(own)) throw new Error(`the engine has no '${own}'`);
        text = text.replaceAll(own, `float ${name} = ${place} + 1.2;`);
    }
    return text;
};

// Processor milliseconds of the browser's processes, which all descend from this one.
const cpuMilliseconds = () => {
    const parents = new Map();
    for (const id of readdirSync('/proc').filter((name) => /^\d+$/.test(name))) {
        try {
            const stat = readFileSync(`/proc/${id}/stat`, 'utf8');
            parents.set(id, stat.slice(stat.lastIndexOf(')') + 2).split(' ')[1]);
        } catch (error) {
            // The process has ended.
        }
    }
    const descends = (id) => {
        for (let at = parents.get(id); at && at !== '0'; at = parents.get(at)) if (at === String(process.pid)) return true;
        return false;
    };
    let sum = 0;
    for (const id of [...parents.keys()].filter(descends)) {
        try {
            for (const task of readdirSync(`/proc/${id}/task`)) {
                sum += Number(readFileSync(`/proc/${id}/task/${task}/schedstat`, 'utf8').split(' ')[0]);
            }
        } catch (error) {
            // The process has ended.
        }
    }
    return String(sum * 1e-6);
};

const page = `<!DOCTYPE html><meta charset="utf-8"><canvas id="c" width="${camera.width}" height="${camera.height}"></canvas>
<script type="module">
${BEGIN}
const pc = await import('/playcanvas.mjs');
const camera = ${JSON.stringify(camera)};
const canvas = document.getElementById('c');
const device = await pc.createGraphicsDevice(canvas, { deviceTypes: ['webgl2'], antialias: false, preserveDrawingBuffer: true });
const options = new pc.AppOptions();
options.graphicsDevice = device;
options.componentSystems = [pc.CameraComponentSystem, pc.GSplatComponentSystem];
options.resourceHandlers = [pc.GSplatHandler, pc.ContainerHandler, pc.TextureHandler, pc.BinaryHandler];
const app = new pc.AppBase(canvas);
app.init(options);
app.setCanvasFillMode(pc.FILLMODE_NONE);
app.setCanvasResolution(pc.RESOLUTION_FIXED, camera.width, camera.height);
app.start();
const eye = new pc.Entity('camera');
eye.addComponent('camera', { clearColor: new pc.Color(0, 0, 0, 1), fov: camera.fov_y_degrees, nearClip: 0.2, farClip: 1000 });
eye.setPosition(...camera.eye);
eye.setRotation(...camera.quat);
app.root.addChild(eye);
const isGlb = ${sceneName.endsWith('.glb')};
const asset = new pc.Asset('scene', isGlb ? 'container' : 'gsplat', { url: '/${sceneName}', filename: '${sceneName}' });
app.assets.add(asset);
await new Promise((resolve, reject) => {
    asset.once('load', resolve);
    asset.once('error', (error) => reject(new Error('the engine cannot read the file: ' + error)));
    app.assets.load(asset);
});
const splats = new pc.Entity('splats');
splats.addComponent('gsplat', { asset: isGlb ? asset.resource.gsplats[0] : asset });
// glTF has y up: x and y point the other way than in a PLY.
if (isGlb) splats.setLocalEulerAngles(0, 0, 180);
app.root.addChild(splats);
// The sorting worker answers some frames later: the picture is done when it stays the same.
app.autoRender = false;
let last = '', same = 0;
for (let frame = 0; frame < 60 + camera.still_frames && same < camera.still_frames; ++frame) {
    app.renderNextFrame = true;
    await new Promise((resolve) => app.once('frameend', resolve));
    await new Promise((resolve) => setTimeout(resolve, 200));
    const now = canvas.toDataURL('image/png');
    same = now === last && frame > 3 ? same + 1 : 0;
    last = now;
    await say('/frame', String(frame));
}
if (camera.timed_frames) {
    const gl = device.gl, pixels = new Uint8Array(4 * camera.width * camera.height);
    const draw = () => {
        const start = performance.now();
        app.render();
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        gl.readPixels(0, 0, camera.width, camera.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
        return performance.now() - start;
    };
    const cpu = async () => Number(await (await fetch('/cpu')).text());
    draw();
    const before = await cpu(), times = [];
    for (let frame = 0; frame < camera.timed_frames; ++frame) times.push(draw());
    const spent = (await cpu() - before) / camera.timed_frames;
    times.sort((a, b) => a - b);
    const lit = pixels.reduce((sum, value, i) => sum + (i % 4 < 3 && value > 0), 0);
    if (lit < pixels.length / 100) throw new Error('the frames that were timed are empty');
    await say('/text', times[times.length >> 1].toFixed(1) + ' ms, ' + spent.toFixed(1) + ' CPU-ms');
}
await say('/done', last);
</script>`;

const files = {
    '/': ['text/html', () => page],
    '/playcanvas.mjs': ['text/javascript', engine],
    '/cpu': ['text/plain', cpuMilliseconds],
    ['/' + sceneName]: ['application/octet-stream', () => readFileSync(scene)]
};
const content = (url) => {
    const [type, body] = files[url] ?? [];
    return type && [type, body()];
};
show(content, output);
