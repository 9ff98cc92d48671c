// What the stage says while there is no picture, and how files get onto it: dropped, chosen, or by a path.

const find = (id) => document.getElementById(id);
/** What takes longer than this is told with its time, ms. */
const LONG = 1500;

export class Stage {
    /** `say` tells people something. */
    constructor(link, say) {
        Object.assign(this, { link, say, text: 'connecting', since: performance.now(), failed: false, pictured: false, waits: true, opens: null });
        setInterval(() => this.show(), 500);
        link.on('loading', ({ name, failed }) => (failed ? this.fail(failed) : this.wait(name ? `reading ${name}` : 'starting')));
        link.on('open', () => { if (this.waits && !this.failed) this.wait('waiting for the scene'); });
        link.on('scene', (scene) => this.open(scene));
        link.on('problem', ({ message }) => { if (!this.pictured && this.waits) this.fail(message); });
        link.on('unreachable', (problem) => { if (!this.pictured) this.fail(`no connection, trying again: ${problem}`); });
        link.on('close', () => { if (!this.pictured && !this.failed) this.wait('no connection, trying again'); });
        find('opener').onsubmit = (event) => { event.preventDefault(); this.openPath(find('path').value.trim()); };
        find('choose').onclick = () => find('choose-file').click();
        find('choose-file').onchange = () => {
            const [file] = find('choose-file').files;
            find('choose-file').value = '';
            if (file) this.send(file);
        };
        // What went wrong stays until it is read.
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
            const [file, more] = event.dataTransfer.files;
            if (more) this.say('one file at a time');
            else if (file) this.send(file);
        });
    }

    /** A scene is there; its first picture is not. */
    open(scene) {
        this.opens = scene.open ?? null;
        find('welcome').hidden = !scene.empty;
        document.body.classList.toggle('empty', scene.empty && !scene.cameras.length);
        find('opener').hidden = !this.opens;
        if (this.opens) {
            const formats = this.opens.formats.filter((format) => format !== '.compressed.ply');
            find('drop-formats').textContent = formats.join(', ');
            find('choose-file').accept = formats.join(',');
            find('open-path').hidden = this.opens.folder === null;
            find('open-folder').textContent = this.opens.folder ?? '';
        }
        // A connection that came back has its picture still.
        this.pictured &&= scene.run === this.run;
        this.run = scene.run;
        if (scene.empty || this.pictured) this.rest();
        else this.wait('waiting for the first picture');
    }

    /** A picture is there. */
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
        const told = failed || time < LONG ? '' : `, ${Math.round(time / 1000)} s`;
        if (find('stage-text').textContent !== text + told) find('stage-text').textContent = text + told;
        find('stage-progress').hidden = share === null || share === undefined;
        find('stage-progress').querySelector('i').style.width = `${100 * (share ?? 0)}%`;
    }

    /** Whether pages may open anything here; says why not. */
    mayOpen() {
        if (!this.opens) this.say('this viewer shows what it was started with; start `ashsplat view` without a path to open others');
        return Boolean(this.opens);
    }

    choose() {
        if (this.mayOpen()) find('choose-file').click();
    }

    send(file) {
        if (!this.mayOpen()) return;
        if (!this.opens.formats.some((format) => file.name.toLowerCase().endsWith(format))) return this.say(`${file.name} is none of ${this.opens.formats.join(', ')}`);
        if (file.size > this.opens.bytes) return this.say(`${file.name} has ${size(file.size)}; reading may take ${size(this.opens.bytes)} here (--max-host-memory)`);
        // fetch() does not say how far it is.
        const request = new XMLHttpRequest();
        request.open('POST', `upload/${encodeURIComponent(file.name)}`);
        request.setRequestHeader('Content-Type', 'application/octet-stream');
        request.upload.onprogress = ({ loaded, total }) => this.wait(`sending ${file.name}`, total ? loaded / total : null);
        request.onload = () => this.answered(request.status, request.responseText);
        request.onerror = () => this.answered(0, `${file.name} could not be sent`);
        this.wait(`sending ${file.name}`, 0);
        request.send(file);
    }

    async openPath(path) {
        if (!path || !this.mayOpen()) return;
        this.wait(`opening ${path}`);
        try {
            const answer = await fetch('open', { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify({ path }) });
            this.answered(answer.status, await answer.text());
        } catch {
            this.answered(0, `${path} could not be asked for`);
        }
    }

    /** When it is taken, the program says by itself how it goes on. */
    answered(status, text) {
        if (status === 202) return;
        this.fail(text.trim().replace(/^\d+: /, '') || `refused (${status})`);
    }
}

function size(bytes) {
    return bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(1)} GB`;
}
