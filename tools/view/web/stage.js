// Messages while there is no picture, and files to open: dropped, chosen, or by a path.

import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
/** Work that takes longer than this is shown with its time, ms. */
const LONG = 1500;
/** Pause in typing after which paths are suggested, ms. */
const PAUSE = 150;

export class Stage {
    /** `say` shows a message to the user. */
    constructor(link, say) {
        Object.assign(this, { link, say, text: texts.connecting, since: performance.now(), failed: false, pictured: false, waits: true, opens: null, others: [] });
        setInterval(() => this.show(), 500);
        link.on('loading', ({ name, failed }) => (failed ? this.fail(failed) : this.wait(name ? texts.reading(name) : texts.starting)));
        link.on('open', () => { if (this.waits && !this.failed) this.wait(texts.waitingForScene); });
        link.on('scene', (scene) => this.open(scene));
        link.on('problem', ({ message }) => { if (!this.pictured && this.waits) this.fail(message); });
        link.on('unreachable', (problem) => { if (!this.pictured) this.fail(texts.noConnection(problem)); });
        link.on('close', () => { if (!this.pictured && !this.failed) this.wait(texts.noConnection()); });
        find('opener').onsubmit = (event) => { event.preventDefault(); this.openPath(find('path').value.trim()); };
        find('path').oninput = () => {
            clearTimeout(this.typed);
            this.typed = setTimeout(() => this.complete(), PAUSE);
        };
        find('choose').onclick = () => find('choose-file').click();
        find('choose-file').onchange = () => {
            const files = [...find('choose-file').files];
            find('choose-file').value = '';
            this.sendAll(files, false);
        };
        // An error stays until the user closes it.
        find('stage-state').onclick = () => { if (this.closes) this.rest(); };
        this.listen();
        this.show();
    }

    listen() {
        let depth = 0;
        const files = (event) => [...event.dataTransfer?.types ?? []].includes('Files');
        addEventListener('dragenter', (event) => { if (files(event) && this.opens && ++depth) find('dropping').hidden = false; });
        addEventListener('dragleave', (event) => { if (files(event) && this.opens && --depth <= 0) { depth = 0; find('dropping').hidden = true; } });
        // Without this the browser would leave the page for the file.
        addEventListener('dragover', (event) => { if (files(event)) event.preventDefault(); });
        addEventListener('drop', (event) => {
            if (!files(event)) return;
            event.preventDefault();
            depth = 0;
            find('dropping').hidden = true;
            this.sendAll([...event.dataTransfer.files], event.shiftKey);
        });
    }

    /** A scene has opened; its first picture has not arrived. */
    open(scene) {
        this.opens = scene.open ?? null;
        const [next, ...others] = scene.empty || scene.run === this.run ? [] : this.others;
        this.others = others;
        if (next) this.send(next, true);
        find('welcome').hidden = !scene.empty;
        document.body.classList.toggle('empty', scene.empty && !scene.cameras.length);
        find('opener').hidden = !this.opens;
        if (this.opens) {
            const { formats } = this.opens;
            find('drop-formats').textContent = formats.join(', ');
            find('choose-file').accept = formats.join(',');
            find('open-path').hidden = this.opens.folder === null;
            const folder = Object.assign(document.createElement('code'), { textContent: this.opens.folder });
            find('path-label').replaceChildren(...texts.pathBelow(folder));
            this.complete();
            this.list(scene.name);
        }
        // After a reconnection to the same scene, its picture is still shown.
        this.pictured &&= scene.run === this.run;
        this.run = scene.run;
        if (scene.empty || this.pictured) this.rest();
        else this.wait(texts.waitingForPicture);
    }

    /** A picture has arrived. */
    picture() {
        if (this.pictured) return;
        this.pictured = true;
        this.rest();
    }

    wait(text, share = null) {
        if (!this.waits || this.text !== text) this.since = performance.now();
        Object.assign(this, { text, share, failed: false, waits: true });
        this.show();
    }

    fail(text) {
        this.others = [];
        Object.assign(this, { text, share: null, failed: true, waits: true });
        this.show();
    }

    rest() {
        Object.assign(this, { waits: false, failed: false });
        this.show();
    }

    get closes() { return this.failed && (this.pictured || this.opens !== null); }

    show() {
        const { waits, failed, text, share, since } = this;
        const box = find('stage-state');
        box.hidden = !waits;
        box.classList.toggle('failed', failed);
        box.classList.toggle('closes', this.closes);
        const time = performance.now() - since;
        const shown = failed || time < LONG ? text : texts.waitedFor(text, Math.round(time / 1000));
        if (find('stage-text').textContent !== shown) find('stage-text').textContent = shown;
        find('stage-progress').hidden = share === null || share === undefined;
        find('stage-progress').querySelector('i').style.width = `${100 * (share ?? 0)}%`;
    }

    /** True if pages may open scenes here; otherwise says why not. */
    mayOpen() {
        if (!this.opens) this.say(texts.opensNothing);
        return Boolean(this.opens);
    }

    choose() {
        if (this.mayOpen()) find('choose-file').click();
    }

    /** Sends files one after another, as scenes side by side; `add` keeps those that are open. */
    sendAll([file, ...rest], add) {
        if (!file) return;
        this.others = rest;
        this.send(file, add);
    }

    send(file, add) {
        if (!this.mayOpen()) return;
        if (!this.opens.formats.some((format) => file.name.toLowerCase().endsWith(format))) return this.say(texts.wrongFormat(file.name, this.opens.formats.join(', ')));
        if (file.size > this.opens.bytes) return this.say(texts.tooLarge(file.name, file.size, this.opens.bytes));
        // fetch() reports no progress of an upload.
        const request = new XMLHttpRequest();
        request.open('POST', `upload/${encodeURIComponent(file.name)}${add ? '?add=1' : ''}`);
        request.setRequestHeader('Content-Type', 'application/octet-stream');
        request.upload.onprogress = ({ loaded, total }) => this.wait(texts.sending(file.name), total ? loaded / total : null);
        request.onload = () => this.answered(request.status, request.responseText);
        request.onerror = () => this.answered(0, texts.notSent(file.name));
        this.wait(texts.sending(file.name), 0);
        request.send(file);
    }

    /** Paths that start with `begin`; `more` if there are others. */
    async paths(begin) {
        const answer = this.opens?.folder ? await post('paths', begin).catch(() => null) : null;
        return answer?.ok ? answer.json() : { paths: [], more: false };
    }

    async complete() {
        const begin = find('path').value;
        const { paths } = await this.paths(begin);
        if (begin === find('path').value) find('paths').replaceChildren(...paths.map((path) => new Option('', path)));
    }

    /** Lists the files of the folder, if it has scenes. */
    async list(shown) {
        const { paths, more } = await this.paths(''), files = paths.filter((path) => !path.endsWith('/'));
        for (const place of document.querySelectorAll('.scenes')) {
            place.hidden = !files.length;
            const title = Object.assign(document.createElement('h2'), { textContent: texts.scenesInFolder(!more) });
            place.replaceChildren(title, ...files.map((path) => {
                const button = Object.assign(document.createElement('button'), { textContent: path, onclick: () => this.openPath(path) });
                button.classList.toggle('on', path === shown);
                return button;
            }));
        }
    }

    async openPath(path) {
        if (!path || !this.mayOpen()) return;
        this.wait(texts.opening(path));
        try {
            const answer = await post('open', path);
            this.answered(answer.status, await answer.text());
        } catch {
            this.answered(0, texts.notAsked(path));
        }
    }

    /** Shows a refusal. If the program accepts, it reports progress itself. */
    answered(status, text) {
        if (status === 202) return;
        this.fail(text.trim().replace(/^\d+: /, '') || texts.refused(status));
    }
}

const post = (route, path) => fetch(route, { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify({ path }) });
