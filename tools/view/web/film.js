// A camera path: keys, a preview here, frames and a film from the program.

import { between } from './camera.js';
import { download } from './frames.js';
import { add, sub, times } from './maths.js';
import { texts } from './texts.js';

/** Widest GIF that the program writes, pixels. */
const GIF_WIDTH = 640;
/** Estimated bytes of a GIF per pixel and frame: orbits of three trained scenes have 0.21 to 0.39. */
const GIF_BYTES = 0.3;

const find = (id) => document.getElementById(id);

export class Film {
    constructor(link, camera, look) {
        Object.assign(this, { link, camera, look, keys: [], playing: false, rendering: false, frame: { origin: [0, 0, 0], unit: 1 } });
        find('film-add').onclick = () => this.add();
        find('film-clear').onclick = () => { this.keys = []; this.list(); };
        find('film-preview').onclick = () => this.preview();
        find('film-render').onclick = () => this.render();
        find('film-save').onclick = () => download(new Blob([JSON.stringify({ ashsplat_path: 1, ...this.settings(), keys: this.inFile() }, null, 1)], { type: 'application/json' }), 'camera_path.json');
        find('film-load').onclick = () => find('film-file').click();
        find('film-file').onchange = () => this.load();
        link.on('film', (progress) => this.progress(progress));
        link.on('close', () => this.stopped());
        for (const id of ['film-seconds', 'film-fps', 'film-size']) find(id).addEventListener('input', () => this.note());
        this.list();
        this.note();
    }

    /** Describes the files that the film will have. */
    note() {
        const { seconds, frames_per_second: rate, width, height } = this.settings();
        const small = Math.min(width, GIF_WIDTH), low = Math.floor(height * small / width);
        const megabytes = small * low * seconds * Math.min(rate, 50) * GIF_BYTES / 1e6;
        find('film-note').textContent = texts.filmNote(Math.max(1, Math.round(seconds * rate)), `${width}×${height}`, `${small}×${low}`, megabytes);
    }

    settings() {
        const [width, height] = find('film-size').value.split('x').map(Number);
        return { seconds: Number(find('film-seconds').value), frames_per_second: Math.round(Number(find('film-fps').value)), closed: find('film-closed').checked, width, height };
    }

    /** The keys in the coordinates of the scene's file. */
    inFile() {
        const { origin, unit } = this.frame;
        return this.keys.map((key) => ({ ...key, position: add(origin, times(key.position, unit)) }));
    }

    add() {
        this.keys.push(this.camera.key());
        this.list();
    }

    list() {
        find('film-count').textContent = texts.filmKeys(this.keys.length);
        find('film-keys').replaceChildren(...this.keys.map((key, index) => {
            const box = document.createElement('span');
            const go = Object.assign(document.createElement('button'), { textContent: index + 1, title: texts.filmGo, onclick: () => this.camera.takeKey(key) });
            const drop = Object.assign(document.createElement('button'), { textContent: '×', title: texts.filmDrop, onclick: () => { this.keys.splice(index, 1); this.list(); } });
            box.append(go, drop);
            return box;
        }));
        for (const id of ['film-preview', 'film-render']) find(id).disabled = this.keys.length < 2;
        for (const id of ['film-clear', 'film-save']) find(id).disabled = this.keys.length < 1;
    }

    async load() {
        const [file] = find('film-file').files;
        find('film-file').value = '';
        try {
            const path = JSON.parse(await file.text());
            const sound = (key) => key.position.length === 3 && key.rotation.length === 3 && key.fov_y > 0;
            if (!path.keys.every(sound)) throw new Error(texts.filmKeysBroken);
            const { origin, unit } = this.frame;
            this.keys = path.keys.map((key) => ({ ...key, position: times(sub(key.position, origin), 1 / unit) }));
            if (path.seconds) find('film-seconds').value = path.seconds;
            if (path.frames_per_second) find('film-fps').value = path.frames_per_second;
            find('film-closed').checked = Boolean(path.closed);
            this.list();
            this.note();
        } catch (error) {
            this.link.emit('problem', { message: texts.filmUnreadable(file.name, error.message) });
        }
    }

    preview() {
        this.playing = !this.playing;
        this.from = performance.now();
        find('film-preview').textContent = this.playing ? texts.filmStop : texts.filmPreview;
    }

    tick(now) {
        if (!this.playing) return;
        const at = Math.max(0, now - this.from) / 1000 / this.settings().seconds;
        this.camera.takeKey(between(this.keys, Math.min(at, 0.9999), find('film-closed').checked));
        if (at >= 1) this.preview();
    }

    render() {
        if (this.rendering) return this.link.send({ type: 'cancel' });
        find('film-result').replaceChildren();
        if (!this.link.send({ type: 'film', keys: this.keys, look: this.look(), ...this.settings() })) return;
        this.rendering = true;
        find('film-render').textContent = texts.filmCancel;
        find('film-progress').hidden = false;
        this.bar(0, 1, texts.filmWaits(0));
    }

    bar(done, total, text) {
        find('film-progress').querySelector('i').style.width = `${100 * done / total}%`;
        find('film-progress').querySelector('span').textContent = text;
    }

    stopped() {
        this.rendering = false;
        find('film-render').textContent = texts.filmRender;
        find('film-progress').hidden = true;
    }

    progress({ done, total, files, cancelled, waiting }) {
        if (cancelled) return this.stopped();
        if (waiting !== undefined) return this.bar(0, 1, texts.filmWaits(waiting));
        this.bar(done, total, done === total && !files ? texts.filmJoins : texts.filmFrame(done, total));
        if (!files) return;
        this.stopped();
        const saved = (name, text) => Object.assign(document.createElement('a'), { href: `film/${name}`, download: name, textContent: text });
        const picture = Object.assign(new Image(), { src: `film/${files.gif}`, alt: texts.theFilm });
        const links = [saved(files.gif, texts.gif), saved(files.path, texts.filmPath)];
        if (files.mp4) links.unshift(saved(files.mp4, texts.mp4));
        const note = Object.assign(document.createElement('p'), { textContent: texts.filmFiles(files.frames, files.note) });
        find('film-result').replaceChildren(picture, ...links, note);
    }
}
