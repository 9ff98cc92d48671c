// Requests and shows frames: coarse while the view moves, sharp when it rests.

/** Frame time to reach while the view moves, ms. */
const GOAL = 55;
const SCALES = [1, 0.75, 0.5, 0.375, 0.25, 0.1875];
/** The view rests after this time without a change, ms. */
const REST = 140;
const MOVING_QUALITY = 68;

export class Frames {
    constructor(link, camera, canvas, look) {
        Object.assign(this, { link, camera, canvas, look, context: canvas.getContext('2d') });
        this.seq = 0;
        this.sent = new Map();
        this.level = 2;
        this.dirty = true;
        this.sharp = false;
        this.changedAt = 0;
        this.shots = new Set();
        this.resolution = 1;
        this.quality = 92;
        /** The photo whose exposure and lens effects are applied, if any. */
        this.light = () => null;
        this.rate = [];
        this.onShown = () => {};
        this.shownSeq = 0;
        link.on('frame', (header, blob) => this.show(header, blob));
        link.on('open', () => { this.sent.clear(); this.leap(); });
    }

    /** The view or its look has changed. */
    touch() {
        this.dirty = true;
        this.sharp = false;
        this.changedAt = performance.now();
    }

    /** The view has jumped: the next frame is sharp. */
    leap() {
        this.dirty = this.sharp = false;
        this.changedAt = 0;
    }

    /** Full size of a picture, pixels. */
    get size() {
        const ratio = Math.min(devicePixelRatio || 1, 2) * this.resolution;
        return [Math.max(16, Math.round(innerWidth * ratio)), Math.max(16, Math.round(innerHeight * ratio))];
    }

    request(scale, quality, look = this.look()) {
        const [width, height] = this.size.map((side) => Math.max(16, Math.round(side * scale)));
        const seq = ++this.seq;
        const message = { type: 'view', seq, camera: this.camera.message(width, height), look: { ...look, quality }, as_photo: this.light(), follow: scale === 1 };
        if (this.link.send(message)) this.sent.set(seq, { time: performance.now(), scale });
        return seq;
    }

    /** Runs once per animation frame. */
    tick(now, busy) {
        if (busy) this.changedAt = Math.max(this.changedAt, now - REST / 2);
        const rests = now - this.changedAt > REST;
        if (this.dirty) {
            this.dirty = false;
            this.request(SCALES[this.level], MOVING_QUALITY);
        } else if (rests && !this.sharp) {
            this.sharp = true;
            this.request(1, this.quality);
        }
    }

    screenshot() {
        this.sharp = true;
        this.shots.add(this.request(1, 0, { ...this.look(), selection: false }));
    }

    async show(header, blob) {
        const sent = this.sent.get(header.seq);
        const now = performance.now();
        // All earlier requests are obsolete now.
        for (const seq of this.sent.keys()) if (seq <= header.seq) this.sent.delete(seq);
        if (sent && sent.scale < 1 || sent?.scale === SCALES[this.level]) this.adapt(now - sent.time, sent.scale);
        this.rate.push(now);
        while (this.rate.length > 1 && (now - this.rate[0] > 2000 || this.rate.length > 40)) this.rate.shift();
        if (this.shots.delete(header.seq)) {
            // Requests a usual sharp frame; otherwise the program would renew the screenshot, a PNG without selection.
            this.sharp = false;
            download(blob, `ashsplat-${new Date().toISOString().slice(0, 19).replaceAll(':', '-')}.png`);
        }
        // A newer view was rendered instead of a screenshot's, so the screenshot is requested again.
        const overtaken = [...this.shots].filter((seq) => seq < header.seq);
        if (overtaken.length) {
            overtaken.forEach((seq) => this.shots.delete(seq));
            this.screenshot();
        }
        const bitmap = await createImageBitmap(blob);
        if (header.seq < this.shownSeq) return bitmap.close();
        this.shownSeq = header.seq;
        if (this.canvas.width !== this.size[0] || this.canvas.height !== this.size[1]) [this.canvas.width, this.canvas.height] = this.size;
        this.context.imageSmoothingQuality = 'high';
        this.context.drawImage(bitmap, 0, 0, this.canvas.width, this.canvas.height);
        bitmap.close();
        header.latency = sent ? performance.now() - sent.time : null;
        header.sharp = header.width === this.size[0];
        this.onShown(header);
    }

    /** Adapts the size to the frame time: slow frames become smaller, fast ones larger again. */
    adapt(milliseconds, scale) {
        const level = SCALES.indexOf(scale);
        if (level < 0) return;
        const wanted = scale * Math.sqrt(GOAL / Math.max(milliseconds, 1));
        if (milliseconds > 1.3 * GOAL && level < SCALES.length - 1) this.level = Math.min(SCALES.length - 1, Math.max(level + 1, SCALES.findIndex((s) => s <= wanted)));
        else if (level > 0 && wanted >= SCALES[level - 1] * 1.1) this.level = level - 1;
        if (this.level < 0) this.level = SCALES.length - 1;
    }

    get framesPerSecond() {
        const { rate } = this;
        return rate.length > 2 ? 1000 * (rate.length - 1) / (rate.at(-1) - rate[0]) : 0;
    }
}

/** Makes the browser save a blob, or the file at an address. */
export function download(what, name) {
    const made = what instanceof Blob;
    const link = Object.assign(document.createElement('a'), { href: made ? URL.createObjectURL(what) : what, download: name });
    link.click();
    if (made) setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
