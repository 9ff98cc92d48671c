// The page: puts its parts together.

import { Camera } from './camera.js';
import { Controls } from './controls.js';
import { Detail } from './detail.js';
import { Edit } from './edit.js';
import { Film } from './film.js';
import { Filter } from './filter.js';
import { Frames } from './frames.js';
import { Link } from './link.js';
import { Overlay } from './overlay.js';
import { Panel } from './panel.js';
import { Place } from './place.js';
import { Photos } from './photos.js';
import { Picker } from './pick.js';
import { Stage } from './stage.js';
import { Tape } from './tape.js';
import { language, texts } from './texts.js';
import { Training } from './training.js';

export const find = (id) => document.getElementById(id);

fill();
const link = new Link();
const camera = new Camera();
const panel = new Panel();
const overlay = new Overlay(find('overlay'), camera);
const filter = new Filter(overlay, say);
const detail = new Detail();
const look = () => ({ ...panel.look(), cut: filter.cut, budget: detail.budget });
const shownLook = () => ({ ...look(), selection: true });
const frames = new Frames(link, camera, find('picture'), shownLook);
const picker = new Picker(link, camera, frames, look, overlay);
const edit = new Edit(link, camera, frames, picker, overlay, filter);
const place = new Place(camera, overlay, picker, panel, say);
const tape = new Tape(picker, overlay, place, say);
const photos = new Photos(camera, overlay, frames);
frames.light = () => photos.light;
const film = new Film(link, camera, look);
const training = new Training(link);
const stage = new Stage(link, say);
let scene = null;
/** View in the page's address; only the first scene uses it. */
let linked = location.hash;
/** Tools that draw with the pointer. */
const STROKES = ['lasso', 'brush', 'sphere'];
const TOOL_KEYS = { KeyG: 'lasso', KeyB: 'brush', KeyN: 'sphere', KeyM: 'tape' };

const controls = new Controls(find('overlay'), camera, {
    click(x, y, event) {
        if (panel.tool === 'tape') tape.click(x, y);
        else if (panel.tool === 'level') place.click(x, y);
        else if (panel.tool === 'inspect' || event.altKey) picker.pick(x, y);
        else photos.jumpTo(overlay.cameraAt(x, y));
    },
    double: (x, y) => picker.pivot(x, y),
    begin: (x, y, event) => (STROKES.includes(panel.tool) ? edit.begin(panel.tool, x, y, event) : null),
    hover(x, y) { if (panel.tool === 'brush') edit.hover([x, y]); },
    key,
    command,
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
    edit.hover(null);
    if (name === 'level') { place.points.length = 0; place.show(); }
    find('overlay').classList.toggle('inspecting', Boolean(panel.tool));
};
panel.rendering = ({ resolution, quality }) => { Object.assign(frames, { resolution, quality }); frames.leap(); };
filter.changed = () => frames.touch();
filter.placement = place;
place.changed = () => { filter.showCommand(); tape.show(); };
detail.changed = () => frames.leap();
find('home').onclick = home;
find('shot').onclick = () => frames.screenshot();
find('link').onclick = copyLink;
find('help').onclick = listKeys;
// A link was entered into the open page.
addEventListener('hashchange', () => { if (scene && camera.takeLink(location.hash, scene.frame)) frames.leap(); });
find('panel-toggle').onclick = togglePanel;
find('fullscreen').hidden = !document.fullscreenEnabled;
find('fullscreen').onclick = fullscreen;
addEventListener('fullscreenchange', () => find('fullscreen').classList.toggle('on', document.fullscreenElement !== null));
// On a phone the picture comes first.
document.body.classList.toggle('bare', innerWidth <= 760 || innerHeight <= 500);
addEventListener('resize', cover);
cover();

function togglePanel() {
    document.body.classList.toggle('bare');
    cover();
}

/** Measures what tools and panel cover. While they slide, their final places count. */
function cover() {
    const [tools, side, title] = ['tools', 'panel', 'title'].map(find), wide = innerWidth > 760, bare = document.body.classList.contains('bare');
    const share = (pixels, all) => Math.min(0.7, Math.max(0, pixels / all));
    const left = wide ? share(tools.offsetLeft + tools.offsetWidth, innerWidth) : 0;
    const right = wide && !bare ? share(innerWidth - side.offsetLeft, innerWidth) : 0;
    // On a low screen the title lies beside the tools.
    const above = wide ? title : tools, top = wide && title.offsetLeft === tools.offsetLeft ? 0 : share(above.offsetTop + above.offsetHeight, innerHeight);
    const bottom = share(innerHeight - (wide || bare ? find('status') : side).offsetTop, innerHeight);
    camera.covered = { left, right, top, bottom };
    camera.changed();
}

function fullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen().catch((error) => say(texts.noFullScreen(error.message)));
}

/** Copies the page's address with this view; a token stays in it. */
async function copyLink() {
    if (!scene || scene.empty) return;
    history.replaceState(null, '', camera.link(scene.frame));
    const token = location.search.includes('token=');
    const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
    say(copied ? texts.linkCopied(token) : texts.linkShown(token));
}

function listKeys() {
    find('keys').showModal();
    find('keys').scrollTop = 0;
}

/** Closes the list of keys with the key that opens it. */
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
    // The first photo's view, if there are photos; else the whole scene.
    const box = scene.cameras.length ? null : filter.whole;
    if (box) camera.fit(box, innerWidth, innerHeight);
    frames.leap();
}

function key(code, event) {
    const digit = /^(?:Digit|Numpad)([1-6])$/.exec(code);
    if (digit) panel.choose(['splats', 'centres', 'ellipsoids', 'depth', 'tiles', 'normals'][digit[1] - 1]);
    else if (event.key === '?') listKeys();
    else if (code === 'KeyV') panel.toggle('fly');
    else if (code === 'KeyI') panel.toggle('inspect');
    else if (code === 'KeyC') panel.toggle('cameras');
    else if (code in TOOL_KEYS) panel.toggle(TOOL_KEYS[code]);
    else if (code === 'Delete' || code === 'Backspace') edit.send('delete');
    else if (code === 'KeyH') togglePanel();
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
    else if (code === 'Escape') escape();
    else if (code === 'Space' && scene?.training !== null) training.toggle();
    else return false;
    return true;
}

/** Handles Ctrl with a key: the letter of the layout, or the usual key if the layout has no such letter. */
function command(event) {
    const letter = (/^[a-z]$/i.test(event.key) ? event.key : event.code.slice(-1)).toLowerCase();
    const act = {
        z: () => edit.send(event.shiftKey ? 'redo' : 'undo'),
        y: () => edit.send('redo'),
        a: () => edit.select({ kind: 'all' }, 'set')
    }[letter];
    if (!edit.allowed || !act) return false;
    if (!event.repeat) act();
    return true;
}

function escape() {
    if (panel.tool) return panel.toggle(panel.tool);
    photos.close();
    picker.close();
}

link.on('open', () => {
    find('connection').textContent = texts.connected;
    find('connection').classList.remove('bad');
});
link.on('close', () => {
    find('connection').textContent = texts.connectionLost;
    find('connection').classList.add('bad');
});
link.on('page', ({ page }) => { photos.page = page; });
link.on('scene', (message) => {
    const added = scene && message.joined === scene.run;
    // Pages can open two scenes of one name; `run` distinguishes them.
    const first = scene === null || scene.name !== message.name || (message.open && scene.run !== message.run);
    scene = message;
    find('scene-name').textContent = `\u200e${message.name}`;
    find('scene-name').title = message.name;
    find('scene-brief').textContent = message.name.split('/').filter(Boolean).at(-1) ?? '';
    find('scene-note').textContent = message.empty ? '' : message.note ?? texts.gaussians(message.gaussians);
    document.title = `${message.name.split('/').filter(Boolean).at(-1) ?? ''} · ashsplat`;
    find('device').textContent = message.device;
    if (message.empty) find('welcome-note').replaceChildren(...marked(message.note ?? ''));
    panel.unit = picker.unit = message.frame.unit;
    film.frame = message.frame;
    panel.open(message);
    filter.open(message, first);
    detail.open(message, first);
    edit.open(message);
    // An added scene changes neither place nor view.
    place.open(message, first && !added);
    if (first && !added) tape.clear();
    training.open(message.training);
    if (first) {
        // Frames on their way may still show the previous scene.
        frames.shownSeq = frames.seq + 1;
        overlay.cameras = message.cameras;
    }
    if (first && !added) {
        Object.assign(camera, { up: message.up, radius: message.radius || 1 });
        if (message.empty || !camera.takeLink(linked, message.frame)) home();
    }
    if (first && !message.empty) {
        linked = '';
        history.replaceState(null, '', location.pathname + location.search);
    }
    if (photos.run !== message.run) photos.open(message);
    frames.leap();
});
link.on('problem', ({ message }) => { say(message); photos.drawn({ seq: Infinity }); });
link.on('note', ({ message }) => say(message));
frames.onShown = (header) => {
    stage.picture();
    panel.showFrame(header, frames.framesPerSecond);
    edit.showFrame(header);
    filter.showFrame(header);
    detail.showFrame(header);
    photos.drawn(header);
    window.ashsplat.shown = header;
};

/** Writes the texts into the elements that name them; a row of one cell is a heading. Until then only the state line is shown. */
function fill() {
    document.documentElement.lang = language;
    for (const element of document.querySelectorAll('[data-text]')) {
        const entry = texts[element.dataset.text];
        const { text, rows = [], ...attributes } = typeof entry === 'string' ? { text: entry } : entry;
        if (text) element.textContent = text;
        for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
        for (const cells of rows) {
            const cell = (text) => Object.assign(document.createElement(cells.length > 1 ? 'td' : 'th'), { textContent: text, colSpan: 3 - cells.length });
            element.insertRow().append(...cells.map(cell));
        }
    }
    for (const part of ['title', 'tools', 'panel', 'panel-toggle', 'status']) find(part).hidden = false;
}

/** Text with its parts between backquotes as code. */
function marked(text) {
    return text.split('`').map((part, index) => {
        if (index % 2 === 0) return document.createTextNode(part);
        return Object.assign(document.createElement('code'), { textContent: part });
    });
}

/** Shows a message for a while. */
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
window.ashsplat = { camera, frames, link, panel, photos, picker, film, training, overlay, filter, detail, edit, place, tape, stage, shown: null };
link.open();
requestAnimationFrame(tick);
