// The page: puts its parts together.

import { Camera } from './camera.js';
import { Controls } from './controls.js';
import { Detail } from './detail.js';
import { Film } from './film.js';
import { Filter } from './filter.js';
import { Frames } from './frames.js';
import { Link } from './link.js';
import { Overlay } from './overlay.js';
import { Panel } from './panel.js';
import { Photos } from './photos.js';
import { Picker } from './pick.js';
import { Stage } from './stage.js';
import { Training } from './training.js';

export const find = (id) => document.getElementById(id);

const link = new Link();
const camera = new Camera();
const panel = new Panel();
const overlay = new Overlay(find('overlay'), camera);
const filter = new Filter(overlay, say);
const detail = new Detail();
const look = () => ({ ...panel.look(), cut: filter.cut, budget: detail.budget });
const frames = new Frames(link, camera, find('picture'), look);
const picker = new Picker(link, camera, frames, look, overlay);
const photos = new Photos(camera, overlay, frames);
frames.light = () => photos.light;
const film = new Film(link, camera, look);
const training = new Training(link);
const stage = new Stage(link, say);
let scene = null;

const controls = new Controls(find('overlay'), camera, {
    click(x, y, event) {
        if (panel.inspecting || event.altKey) picker.pick(x, y);
        else photos.jumpTo(overlay.cameraAt(x, y));
    },
    double: (x, y) => picker.pivot(x, y),
    key,
    covered
});

camera.changed = () => {
    frames.touch();
    photos.follow();
    panel.showFov(camera.fovY);
    overlay.pixel = null;
    overlay.draw();
};
panel.changed = () => frames.touch();
panel.leapt = () => frames.leap();
panel.fovChanged = (fov) => { camera.fovY = fov; camera.touch(); };
panel.toggled = (name, on) => {
    if (name === 'fly') controls.flying = on;
    if (name === 'cameras') { overlay.showsCameras = on; overlay.draw(); }
    find('overlay').classList.toggle('inspecting', panel.inspecting);
};
panel.rendering = ({ resolution, quality }) => { Object.assign(frames, { resolution, quality }); frames.leap(); };
filter.changed = () => frames.touch();
detail.changed = () => frames.leap();
find('home').onclick = home;
find('shot').onclick = () => frames.screenshot();
find('help').onclick = listKeys;
find('panel-toggle').onclick = () => document.body.classList.toggle('bare');
find('fullscreen').hidden = !document.fullscreenEnabled;
find('fullscreen').onclick = fullscreen;
addEventListener('fullscreenchange', () => find('fullscreen').classList.toggle('on', document.fullscreenElement !== null));
// On a phone the picture comes first.
document.body.classList.toggle('bare', innerWidth <= 760 || innerHeight <= 500);
addEventListener('resize', () => { frames.touch(); photos.follow(); overlay.draw(); });

function fullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen().catch((error) => say(`no whole screen: ${error.message}`));
}

function listKeys() {
    find('keys').showModal();
    find('keys').scrollTop = 0;
}

/** What opens the list of keys closes it. */
function covered(event) {
    if (event.key !== '?' || event.repeat || !find('keys').open) return false;
    find('keys').close();
    return true;
}

function home() {
    if (!scene?.start) return;
    camera.pivot = scene.pivot;
    camera.take(scene.start);
    camera.touch();
    frames.leap();
}

function key(code, event) {
    const digit = /^(?:Digit|Numpad)([1-5])$/.exec(code);
    if (digit) panel.choose(['splats', 'centres', 'ellipsoids', 'depth', 'tiles'][digit[1] - 1]);
    else if (event.key === '?') listKeys();
    else if (code === 'KeyV') panel.toggle('fly');
    else if (code === 'KeyI') panel.toggle('inspect');
    else if (code === 'KeyC') panel.toggle('cameras');
    else if (code === 'KeyH') document.body.classList.toggle('bare');
    else if (code === 'KeyP') frames.screenshot();
    else if (code === 'KeyK') film.add();
    else if (code === 'KeyF' && event.shiftKey) fullscreen();
    else if (code === 'KeyX') filter.toggle();
    else if (code === 'KeyO') stage.choose();
    else if (code === 'KeyF') camera.face(scene?.pivot ?? camera.pivot);
    else if (code === 'Home') home();
    else if (code === 'BracketLeft') photos.step(-1);
    else if (code === 'BracketRight') photos.step(1);
    else if (code === 'KeyL') photos.toggleLight();
    else if (code === 'Escape') { photos.close(); picker.close(); }
    else if (code === 'Space' && scene?.training !== null) training.toggle();
    else return false;
    return true;
}

link.on('open', () => {
    find('connection').textContent = 'connected';
    find('connection').classList.remove('bad');
});
link.on('close', () => {
    find('connection').textContent = 'connection lost, trying again';
    find('connection').classList.add('bad');
});
link.on('page', ({ page }) => { photos.page = page; });
link.on('scene', (message) => {
    // Where pages open scenes, two of them may have one name.
    const first = scene === null || scene.name !== message.name || (message.open && scene.run !== message.run);
    scene = message;
    find('scene-name').textContent = `\u200e${message.name}`;
    find('scene-name').title = message.name;
    find('scene-brief').textContent = message.name.split('/').filter(Boolean).at(-1) ?? '';
    find('scene-note').textContent = message.empty ? '' : message.note ?? `${message.gaussians.toLocaleString('en')} Gaussians`;
    document.title = `${message.name.split('/').filter(Boolean).at(-1) ?? ''} · ashsplat`;
    find('device').textContent = message.device;
    if (message.empty) find('welcome-note').replaceChildren(...marked(message.note ?? ''));
    // Tiles that come later belong to the picture, too.
    frames.follow = message.training !== null || Boolean(message.tree);
    panel.unit = picker.unit = message.frame.unit;
    film.frame = message.frame;
    panel.open(message);
    filter.open(message, first);
    detail.open(message, first);
    training.open(message.training);
    if (first) {
        // Frames that are on their way may be of the scene before.
        frames.shownSeq = frames.seq + 1;
        Object.assign(camera, { up: message.up, radius: message.radius || 1 });
        overlay.cameras = message.cameras;
        home();
    }
    if (photos.run !== message.run) photos.open(message);
    frames.leap();
});
link.on('problem', ({ message }) => { say(message); photos.drawn({ seq: Infinity }); });
link.on('note', ({ message }) => say(message));
frames.onShown = (header) => {
    stage.picture();
    panel.showFrame(header, frames.framesPerSecond);
    filter.showFrame(header);
    detail.showFrame(header);
    photos.drawn(header);
    window.ashsplat.shown = header;
};

/** Text in which what stands between backquotes is code. */
function marked(text) {
    return text.split('`').map((part, index) => {
        if (index % 2 === 0) return document.createTextNode(part);
        return Object.assign(document.createElement('code'), { textContent: part });
    });
}

/** Says something for a while. */
export function say(text) {
    const box = find('message');
    box.textContent = text;
    box.hidden = false;
    clearTimeout(say.silence);
    say.silence = setTimeout(() => { box.hidden = true; }, 6000);
}

function tick(now) {
    controls.tick(now);
    film.tick(now);
    if (scene && !scene.empty) frames.tick(now, controls.busy || film.playing);
    requestAnimationFrame(tick);
}

// For tests, and for the curious.
window.ashsplat = { camera, frames, link, panel, photos, picker, film, training, overlay, filter, detail, stage, shown: null };
link.open();
requestAnimationFrame(tick);
