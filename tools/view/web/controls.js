// Mouse, touch and keyboard, as people know them from SuperSplat and Blender.

import { clamp } from './maths.js';

/** Radians per pixel. */
const TURN = 0.006;
/** Movement below this is a click, pixels. */
const CLICK = 4;
const FLY_KEYS = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, 1, 0], KeyE: [0, -1, 0] };
const TURN_KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const ZOOM_KEYS = { Equal: -1, NumpadAdd: -1, Minus: 1, NumpadSubtract: 1 };

export class Controls {
    /**
     * `actions`: click(x, y, event), double(x, y), key(code, event) → handled; command(event) → handled, with Ctrl; covered(event)
     * → handled, while a dialog is open; begin(x, y, event) → a stroke { move, end, cancel } of a tool, or nothing to move the view.
     */
    constructor(surface, camera, actions) {
        Object.assign(this, { surface, camera, actions, flying: false, held: new Set(), pointers: new Map(), last: 0, clicked: null });
        surface.addEventListener('pointerdown', (e) => this.down(e));
        surface.addEventListener('pointermove', (e) => this.move(e));
        for (const end of ['pointerup', 'pointercancel']) surface.addEventListener(end, (e) => this.up(e));
        surface.addEventListener('wheel', (e) => this.wheel(e), { passive: false });
        surface.addEventListener('contextmenu', (e) => e.preventDefault());
        addEventListener('keydown', (e) => this.key(e));
        addEventListener('keyup', (e) => this.held.delete(e.code));
        addEventListener('blur', () => this.held.clear());
    }

    down(e) {
        this.surface.setPointerCapture(e.pointerId);
        this.surface.focus({ preventScroll: true });
        this.pointers.set(e.pointerId, { x: e.clientX, y: e.clientY });
        this.moved = this.pointers.size > 1 ? Infinity : 0;
        // A second finger moves the view.
        this.stroke?.cancel();
        this.stroke = this.pointers.size === 1 && e.button === 0 && !e.ctrlKey ? this.actions.begin(e.clientX, e.clientY, e) : null;
        this.surface.classList.add('dragging');
        if (e.button === 1) e.preventDefault();
    }

    move(e) {
        const pointer = this.pointers.get(e.pointerId);
        if (!pointer) return this.actions.hover(e.clientX, e.clientY);
        const [dx, dy] = [e.clientX - pointer.x, e.clientY - pointer.y];
        if (this.stroke) this.stroke.move(e.clientX, e.clientY);
        else if (this.pointers.size === 2) this.pinch(e, dx, dy);
        else if (this.pointers.size === 1) this.drag(e, dx, dy);
        Object.assign(pointer, { x: e.clientX, y: e.clientY });
    }

    drag(e, dx, dy) {
        this.moved += Math.abs(dx) + Math.abs(dy);
        if (this.moved < CLICK) return;
        const { camera } = this;
        if (e.buttons & 2 || e.shiftKey) camera.pan(dx, dy, innerHeight);
        else if (e.ctrlKey) camera.dolly(Math.exp(dy * 0.008));
        else if (this.flying) camera.look(-dx * TURN * 0.6, -dy * TURN * 0.6);
        else camera.orbit(-dx * TURN, -dy * TURN);
    }

    pinch(e, dx, dy) {
        this.moved = Infinity;
        const other = [...this.pointers.entries()].find(([id]) => id !== e.pointerId)[1];
        const before = Math.hypot(e.clientX - dx - other.x, e.clientY - dy - other.y);
        const after = Math.hypot(e.clientX - other.x, e.clientY - other.y);
        if (before > 1 && after > 1) this.camera.dolly(before / after);
        this.camera.pan(dx / 2, dy / 2, innerHeight);
    }

    up(e) {
        if (!this.pointers.delete(e.pointerId)) return;
        this.surface.classList.remove('dragging');
        if (this.stroke) {
            const { stroke } = this;
            this.stroke = null;
            return e.type === 'pointerup' ? stroke.end() : stroke.cancel();
        }
        if (e.type !== 'pointerup' || this.moved >= CLICK || e.button > 0) return;
        // Time of the event itself, which a busy page receives later.
        const now = e.timeStamp, { clicked } = this;
        const near = clicked && Math.hypot(e.clientX - clicked.x, e.clientY - clicked.y) < 12;
        if (near && now - clicked.time < 400) {
            this.clicked = null;
            this.actions.double(e.clientX, e.clientY);
        } else {
            this.clicked = { x: e.clientX, y: e.clientY, time: now };
            this.actions.click(e.clientX, e.clientY, e);
        }
    }

    wheel(e) {
        e.preventDefault();
        const lines = e.deltaMode === 1 ? 16 : 1;
        const amount = clamp(e.deltaY * lines, -240, 240);
        if (this.flying) this.camera.fly([0, 0, -amount * 0.001 * this.camera.radius]);
        else this.camera.dolly(Math.exp(amount * 0.0012));
    }

    key(e) {
        // An open dialog receives all keys; Esc closes it.
        if (document.querySelector('dialog[open]')) {
            if (this.actions.covered(e)) e.preventDefault();
            return;
        }
        const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(e.target.tagName) && !['range', 'checkbox', 'radio', 'color'].includes(e.target.type);
        if (!typing && (e.ctrlKey || e.metaKey) && this.actions.command(e)) return e.preventDefault();
        if (typing || e.metaKey || e.ctrlKey && e.code !== 'ControlLeft') return;
        const steers = e.code in FLY_KEYS || e.code in TURN_KEYS || e.code in ZOOM_KEYS;
        if (steers && (!['range', 'radio'].includes(e.target.type) || e.code in FLY_KEYS)) {
            e.preventDefault();
            if (!this.held.size) this.last = 0;
            this.held.add(e.code);
            // Steers at once, because a press may be shorter than a tick.
            if (!e.repeat) this.steer(1 / 60, e);
            Object.assign(this, { fast: e.shiftKey, slow: e.altKey });
        } else if (!e.repeat && this.actions.key(e.code, e)) {
            e.preventDefault();
        }
    }

    steer(seconds) {
        const { camera, held } = this;
        const speed = this.fast ? 4 : this.slow ? 0.2 : 1;
        const stride = seconds * speed * 0.6 * camera.radius;
        let moved = [0, 0, 0], any = false;
        for (const code of held) {
            if (FLY_KEYS[code]) { moved = moved.map((v, i) => v + FLY_KEYS[code][i] * stride); any = true; }
            if (TURN_KEYS[code]) camera.orbit(TURN_KEYS[code][0] * seconds * speed, TURN_KEYS[code][1] * seconds * speed);
            if (ZOOM_KEYS[code]) camera.dolly(Math.exp(ZOOM_KEYS[code] * seconds * speed));
        }
        if (any) camera.fly(moved);
    }

    /** Runs once per animation frame. */
    tick(now) {
        if (this.held.size) this.steer(clamp((now - (this.last || now)) / 1000, 0, 0.1));
        this.last = now;
    }

    /** True while the view is moved. */
    get busy() { return this.held.size > 0 || this.pointers.size > 0 && this.moved >= CLICK; }
}
