// The tools on the left, the appearance on the right, the line at the bottom.

import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
/** Tools of the pointer; at most one is on. */
const TOOLS = ['inspect', 'lasso', 'brush', 'sphere', 'tape', 'level'];
const UNITS = { depth: texts.depthUnit, tiles: texts.tilesUnit };

export class Panel {
    constructor() {
        this.mode = 'splats';
        this.background = null;
        this.on = { fly: false, cameras: false, inspect: false, lasso: false, brush: false, sphere: false, tape: false, level: false };
        this.changed = this.leapt = this.fovChanged = this.toggled = this.rendering = () => {};
        for (const button of document.querySelectorAll('#modes button')) button.onclick = () => this.choose(button.dataset.mode);
        for (const name of Object.keys(this.on)) find(name).onclick = () => this.toggle(name);
        this.slider('fov', (value) => `${value.toFixed(1)}°`, (value) => this.fovChanged(value * Math.PI / 180));
        this.slider('scale', (value) => value.toFixed(2), () => this.changed());
        this.slider('sh', (value) => String(value), () => this.changed());
        find('background').oninput = () => {
            const hex = find('background').value;
            this.background = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
            this.changed();
        };
        find('background-reset').onclick = () => { this.background = null; this.showBackground(); this.leapt(); };
        for (const id of ['resolution', 'quality']) find(id).onchange = () => this.rendering({ resolution: Number(find('resolution').value), quality: Number(find('quality').value) });
        this.choose('splats');
    }

    slider(id, text, act) {
        const input = find(id), output = input.parentElement.querySelector('output');
        const show = () => { output.textContent = text(Number(input.value)); };
        input.show = show;
        input.oninput = () => { show(); act(Number(input.value)); };
        show();
    }

    /** The tool of the pointer; undefined to move the view. */
    get tool() { return TOOLS.find((name) => this.on[name]); }

    open({ sh_degree: degree, background }) {
        const sh = find('sh');
        const highest = Number(sh.value) === Number(sh.max) || Number(sh.value) > degree;
        sh.max = degree;
        if (highest) sh.value = degree;
        sh.parentElement.hidden = degree === 0;
        sh.show();
        this.trained = background;
        this.showBackground();
    }

    showBackground() {
        const [r, g, b] = (this.background ?? this.trained ?? [0, 0, 0]).map((v) => Math.round(255 * v).toString(16).padStart(2, '0'));
        find('background').value = `#${r}${g}${b}`;
        find('background-reset').hidden = this.background === null;
    }

    choose(mode) {
        this.mode = mode;
        for (const button of document.querySelectorAll('#modes button')) {
            button.classList.toggle('on', button.dataset.mode === mode);
            button.setAttribute('role', 'radio');
            button.setAttribute('aria-checked', button.dataset.mode === mode);
        }
        find('legend').hidden = true;
        this.leapt();
    }

    toggle(name) {
        if (find(name).hidden) return;
        const before = TOOLS.includes(name) && this.tool;
        if (before && before !== name) this.toggle(before);
        this.on[name] = !this.on[name];
        find(name).classList.toggle('on', this.on[name]);
        find(name).setAttribute('aria-pressed', this.on[name]);
        this.toggled(name, this.on[name]);
    }

    look() {
        const sh = Number(find('sh').value);
        return { mode: this.mode, background: this.background, sh_degree: sh < Number(find('sh').max) ? sh : null, scale: Number(find('scale').value) };
    }

    showFov(fov) {
        const input = find('fov');
        if (document.activeElement === input && input.matches(':active')) return;
        input.value = fov * 180 / Math.PI;
        input.show();
    }

    showFrame(header, rate) {
        const { stats, legend } = header;
        find('size').textContent = `${header.width}×${header.height}`;
        const [speed, rendering = ''] = texts.speed(rate, header.latency, header.render_ms);
        find('speed').replaceChildren(speed, Object.assign(document.createElement('small'), { textContent: rendering }));
        find('counts').textContent = texts.visible(stats.visible, stats.gaussians, stats.instances);
        const has = Array.isArray(legend) && this.mode in UNITS;
        find('legend').hidden = !has;
        if (!has) return;
        find('legend').classList.toggle('near', this.mode === 'depth');
        const [low, high] = legend.map((end) => this.mode === 'depth' ? (end * this.unit).toPrecision(3) : end.toFixed(0));
        find('legend-low').textContent = low;
        find('legend-high').textContent = high;
        find('legend-unit').textContent = UNITS[this.mode];
    }
}
