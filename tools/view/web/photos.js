// The data set's photos: jumping to a photo's camera, and comparing photo and render with a wipe.

import { texts } from './texts.js';

const find = (id) => document.getElementById(id);

export class Photos {
    constructor(camera, overlay, frames) {
        Object.assign(this, { camera, overlay, frames, entries: [], page: 0, hasPhotos: false, share: 0.5, current: -1, loading: false, drawnBefore: Infinity });
        const wipe = find('wipe');
        wipe.onpointerdown = (e) => { wipe.setPointerCapture(e.pointerId); this.dragging = true; };
        wipe.onpointermove = (e) => {
            if (!this.dragging) return;
            this.share = Math.min(1, Math.max(0, (e.clientX - this.place.x) / this.place.width));
            this.layOut();
        };
        wipe.onpointerup = wipe.onpointercancel = () => { this.dragging = false; };
        find('photo-previous').onclick = () => this.step(-1);
        find('photo-next').onclick = () => this.step(1);
        find('photo-close').onclick = () => this.close();
        find('photo-light').onchange = () => this.frames.leap();
        find('photo').onload = () => { this.loading = false; this.follow(); };
        find('photo').onerror = () => { this.loading = false; find('wipe-photo').textContent = texts.photoUnreadable; this.follow(); };
    }

    open({ cameras, has_photos: hasPhotos, run }) {
        this.close();
        this.entries = cameras;
        this.run = run;
        this.hasPhotos = hasPhotos;
        find('photos').hidden = cameras.length === 0;
        find('cameras').hidden = cameras.length === 0;
        find('photo-count').textContent = cameras.length;
        find('photo-lit').hidden = !cameras.some(({ lit }) => lit);
        find('photo-list').replaceChildren(...cameras.map(({ name, label: text, lit, held_out: heldOut }, index) => {
            const button = document.createElement('button');
            button.title = texts.photoTitle(name, heldOut, lit);
            button.classList.toggle('lit', lit);
            button.classList.toggle('held-out', heldOut);
            button.onclick = () => this.jumpTo(index);
            const label = Object.assign(document.createElement('span'), { textContent: text });
            label.dataset.heldOut = texts.heldOut;
            if (hasPhotos) button.append(Object.assign(new Image(), { loading: 'lazy', decoding: 'async', src: this.address('thumbnail', index), alt: '' }));
            else button.classList.add('plain');
            button.append(label);
            return button;
        }));
    }

    /** `run` distinguishes scenes whose photos share numbers; `page` lets the server give each page its turn. */
    address(kind, index) { return `${kind}/${index}?run=${this.run}&page=${this.page}`; }

    step(by) {
        const { length } = this.entries;
        if (length) this.jumpTo(((this.current < 0 ? (by > 0 ? -1 : 0) : this.current) + by + length) % length);
    }

    jumpTo(index) {
        const entry = this.entries[index];
        if (!entry) return;
        this.current = this.overlay.current = index;
        this.camera.take(entry.camera, true);
        this.frames.leap();
        [...find('photo-list').children].forEach((button, i) => button.classList.toggle('on', i === index));
        find('photo-list').children[index].scrollIntoView({ block: 'nearest' });
        if (this.hasPhotos) {
            find('photo').src = this.address('photo', index);
            find('wipe-photo').textContent = entry.held_out ? texts.photoHeldOut : texts.photo;
            this.shown = this.loading = true;
            this.drawnBefore = this.frames.seq;
        }
        this.follow();
    }

    /** The photo whose exposure and lens effects apply: only while the view is exactly the photo's. */
    get light() {
        const entry = this.camera.lens === null ? null : this.entries[this.current];
        return entry?.lit && find('photo-light').checked ? this.current : null;
    }

    /** Switches exposures and lens effects, if any photo's are known. */
    toggleLight() {
        if (!find('photo-lit').hidden) find('photo-light').click();
    }

    /** A frame was shown, or none can be. The first frame after a jump has the photo's view. */
    drawn({ seq }) {
        if (seq > this.drawnBefore) this.drawnBefore = Infinity;
        this.follow();
    }

    /** Shows the photo while the view is exactly the photo's, once photo and frame have arrived. */
    follow() {
        const visible = this.shown && this.camera.lens !== null;
        const waits = this.loading || this.drawnBefore < Infinity;
        find('wipe').hidden = !visible;
        find('photo').hidden = !visible || waits;
        find('wipe').classList.toggle('waits', waits);
        if (visible) this.layOut();
    }

    layOut() {
        const place = this.place = this.camera.frame(innerWidth, innerHeight);
        const photo = find('photo');
        Object.assign(photo.style, { left: `${place.x}px`, top: `${place.y}px`, width: `${place.width}px`, height: `${place.height}px`, clipPath: `inset(0 ${100 * (1 - this.share)}% 0 0)` });
        find('wipe').style.left = `${place.x + this.share * place.width}px`;
    }

    close() {
        if (this.light !== null) this.frames.leap();
        this.shown = false;
        this.current = this.overlay.current = -1;
        for (const button of find('photo-list').children) button.classList.remove('on');
        this.follow();
        this.overlay.draw();
    }
}
