// Cuts of the scene: faint Gaussians, floaters, everything outside a box. The program applies them while it draws; each
// frame names the command that cuts the file in the same way.

import { download } from './frames.js';
import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
const AXES = ['x', 'y', 'z'];
/** The floaters' slider goes from this share of the median density to the median itself. */
const LEAST_SHARE = 1e-4;
/** Steps of a slider of the box. */
const STEPS = 400;
/** Gaussians are counted once a cut rests for this time, because counting takes longer than a frame, ms. */
const REST_MS = 400;

/** A number of few digits, in the program's single precision. */
const rounded = (value) => Math.fround(Number(value.toPrecision(4)));

export class Filter {
    /** `say` shows a message to the user. */
    constructor(overlay, say) {
        Object.assign(this, { overlay, say, off: false, median: 1, ranges: null, shown: null });
        this.changed = () => {};
        for (const id of ['min-opacity', 'floaters']) find(id).oninput = () => this.act();
        this.sides = [...document.querySelectorAll('#filter .side')].map((row) => [...row.querySelectorAll('input')]);
        this.sides.forEach((pair, axis) => pair.forEach((input, end) => {
            Object.assign(input, { min: 0, max: STEPS, step: 1, value: end * STEPS });
            input.oninput = () => this.drag(axis, end);
        }));
        find('filter-reset').onclick = () => this.reset();
        find('command-copy').onclick = () => this.copy();
        find('export-part').onchange = () => this.showCommand();
        find('export-save').onclick = () => this.save(find('export-format').value);
        this.show();
    }

    open(scene, first) {
        // No frame has shown this scene yet, and exports wait for one.
        if (scene.run !== this.scene?.run) this.shown = null;
        this.scene = scene;
        find('filter').hidden = scene.empty;
        // Only a part of a tree is loaded, so it can be neither counted nor saved.
        find('exports').hidden = Boolean(scene.tree);
        if (first) find('export-format').replaceChildren(...scene.formats.map((format) => new Option(format.slice(1), format)));
        this.median = scene.densities?.[3] || 1;
        this.ranges = scene.central_bounds && this.rangesOf(scene);
        if (first) this.reset();
        this.show();
    }

    /** Range of an axis' sliders: the central part of the scene and as much on either side, within the scene's bounds. */
    rangesOf({ bounds: [low, high], central_bounds: [from, to] }) {
        return AXES.map((_, i) => {
            const size = Math.max(to[i] - from[i], 1e-6);
            const [a, b] = [Math.max(low[i], from[i] - size), Math.min(high[i], to[i] + size)];
            return b > a ? [a, b] : [a - 0.5, a + 0.5];
        });
    }

    /** The box that the sliders span; none for an empty scene. */
    get whole() { return this.ranges && [0, 1].map((end) => this.ranges.map((range) => range[end])); }

    /** Side of the box; open if its slider is at the end. */
    side(axis, end) {
        const at = Number(this.sides[axis][end].value);
        if (!this.ranges || at === end * STEPS) return null;
        const [low, high] = this.ranges[axis];
        return rounded(low + (high - low) * at / STEPS);
    }

    /** The cut as a message to the program. */
    get cut() {
        if (this.off) return {};
        const opacity = Number(find('min-opacity').value), share = this.share;
        return {
            min_opacity: opacity ? rounded(opacity) : null,
            min_density: share ? rounded(this.median * share) : null,
            low: AXES.map((_, axis) => this.side(axis, 0)),
            high: AXES.map((_, axis) => this.side(axis, 1))
        };
    }

    /** Least density as a share of the median; 0 for none. */
    get share() {
        const at = Number(find('floaters').value) / 100;
        return at && LEAST_SHARE ** (1 - at);
    }

    get active() {
        const all = (pair) => Number(pair[0].value) === 0 && Number(pair[1].value) === STEPS;
        return Number(find('min-opacity').value) > 0 || this.share > 0 || !this.sides.every(all);
    }

    drag(axis, end) {
        const [from, to] = this.sides[axis], gap = 4;
        if (Number(to.value) - Number(from.value) < gap) {
            if (end === 0) from.value = Math.max(0, Number(to.value) - gap);
            else to.value = Math.min(STEPS, Number(from.value) + gap);
        }
        this.act();
    }

    act() {
        this.off = false;
        this.show();
        this.changed();
    }

    reset() {
        find('min-opacity').value = find('floaters').value = 0;
        this.sides.forEach((pair) => pair.forEach((input, end) => { input.value = end * STEPS; }));
        this.act();
    }

    /** Switches the cut off for comparison, and on again. */
    toggle() {
        if (!this.active) return;
        this.off = !this.off;
        this.show();
        this.changed();
    }

    show() {
        const text = (id, words) => { find(id).parentElement.querySelector('output').textContent = words; };
        const opacity = Number(find('min-opacity').value), { share } = this;
        text('min-opacity', opacity ? opacity.toFixed(2) : texts.everyOpacity);
        text('floaters', share ? `${Number((100 * share).toPrecision(2))} %` : texts.floatersShown);
        this.sides.forEach(([from, to]) => {
            const bar = from.parentElement.querySelector('i');
            Object.assign(bar.style, { left: `${100 * from.value / STEPS}%`, right: `${100 - 100 * to.value / STEPS}%` });
            // The slider that can still move lies on top.
            from.style.zIndex = Number(from.value) > STEPS / 2 ? 2 : 1;
        });
        const sides = AXES.map((name, axis) => {
            const [low, high] = [0, 1].map((end) => this.side(axis, end));
            if (low === null && high === null) return '';
            const { origin, unit } = this.scene.frame;
            const source = (value) => String(origin[axis] + short(unit * value));
            return `${name} ${low === null ? '' : `${source(low)} `}…${high === null ? '' : ` ${source(high)}`}`;
        }).filter(Boolean);
        find('box-text').hidden = !sides.length;
        find('box-text').textContent = sides.join(', ');
        find('filter-reset').hidden = !this.active;
        find('filter').classList.toggle('off', this.off);
        this.overlay.box = sides.length && !this.off ? this.corners() : null;
        this.overlay.draw();
    }

    corners() {
        return [0, 1].map((end) => AXES.map((_, axis) => this.side(axis, end) ?? this.ranges[axis][end]));
    }

    /** Takes the cut that a frame shows. */
    showFrame({ convert, export: address, edits }) {
        Object.assign(this, { shown: address, convert });
        // No command can repeat edits by hand.
        this.edited = Boolean(edits?.hidden || edits?.deleted);
        this.showCommand();
        const { tree, run } = this.scene ?? {};
        this.count(convert && !tree ? `${address}&run=${run}&revision=${edits?.revision ?? 0}` : null);
    }

    /** Shows the command that makes the same file: the cut, and the scene's new place. */
    showCommand() {
        const options = `${this.convert ?? ''}${this.placement.options}`.trim();
        const command = options && this.scene?.convert && !this.edited && !find('export-part').value ? `${this.scene.convert} ${options}` : '';
        find('command').hidden = !command;
        if (find('command-text').textContent === command) return;
        // Lines end between words, not within options.
        const words = command.split(' ').map((word) => Object.assign(document.createElement('span'), { textContent: word }));
        find('command-text').replaceChildren(...words.flatMap((word, index) => (index ? [' ', word] : [word])));
    }

    /** Counts the Gaussians that a cut leaves, once the cut rests; null for none. */
    count(address) {
        if (address === this.counted) return;
        this.counted = address;
        clearTimeout(this.timer);
        find('cut-count').hidden = true;
        if (address !== null) this.timer = setTimeout(() => this.ask(address), REST_MS);
    }

    async ask(address) {
        const answer = await fetch(`count?${address}`).catch(() => null);
        if (address !== this.counted) return;
        // The program is busy with exports: asks again later.
        if (answer?.status === 503) this.timer = setTimeout(() => this.ask(address), 5 * REST_MS);
        if (!answer?.ok) return;
        const { kept, of } = await answer.json();
        if (address !== this.counted) return;
        find('cut-count').textContent = texts.stay(kept, of);
        find('cut-count').hidden = false;
    }

    async copy() {
        const box = find('command-text');
        try {
            await navigator.clipboard.writeText(box.textContent);
            this.say(texts.copied);
        } catch {
            // Without access to the clipboard, the command is selected so that the user can copy it.
            getSelection().selectAllChildren(box);
        }
    }

    /** Saves the scene as it was shown last. The browser writes the file while it arrives. */
    async save(format) {
        if (this.shown === null || !this.scene || this.scene.empty) return;
        const part = find('export-part').value;
        const mark = part ? '_selection' : this.edited || !find('command').hidden ? '_cut' : '';
        const name = `${this.scene.stem}${mark}${format}`, query = `${this.shown}${this.placement.query}${part && `&part=${part}`}`;
        const answer = await fetch(`count?${query}&format=${format.slice(1)}`).catch(() => null);
        if (!answer?.ok) return this.say(answer ? (await answer.text()).trim().replace(/^\d+: /, '') : texts.viewerEnded);
        const { losses } = await answer.json();
        download(`export/${encodeURIComponent(name)}?${query}`, name);
        this.say(texts.exported(name, losses));
    }
}

const short = (value) => Number(value.toPrecision(3));
