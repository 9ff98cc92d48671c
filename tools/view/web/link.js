// The WebSocket: messages by type, frames, and reconnection.

import { texts } from './texts.js';

const FIRST_DELAY = 250, LONGEST_DELAY = 4000;

export class Link {
    constructor() {
        this.listeners = new Map();
        this.delay = FIRST_DELAY;
        this.socket = null;
        this.ended = false;
        // Relative to the page, which a proxy may show below a path.
        this.address = new URL(`socket${location.search}`, document.baseURI);
    }

    on(type, listener) {
        if (!this.listeners.has(type)) this.listeners.set(type, []);
        this.listeners.get(type).push(listener);
    }

    emit(type, ...values) {
        for (const listener of this.listeners.get(type) ?? []) listener(...values);
    }

    open() {
        const address = new URL(this.address);
        address.protocol = location.protocol === 'https:' ? 'wss:' : 'ws:';
        const socket = new WebSocket(address);
        socket.binaryType = 'arraybuffer';
        this.socket = socket;
        let opened = false;
        socket.onopen = () => {
            opened = true;
            this.delay = FIRST_DELAY;
            this.emit('open');
        };
        socket.onmessage = ({ data }) => {
            if (typeof data === 'string') {
                const message = JSON.parse(data);
                this.emit(message.type, message);
            } else {
                this.frame(data);
            }
        };
        socket.onclose = () => {
            if (this.socket !== socket) return;
            this.socket = null;
            this.emit('close');
            if (!opened) this.explain();
            setTimeout(() => this.open(), this.delay);
            this.delay = Math.min(2 * this.delay, LONGEST_DELAY);
        };
    }

    /** Says why the socket did not open: pages cannot read a handshake's answer, but that of a POST. */
    async explain() {
        const answer = await fetch(this.address, { method: 'POST' }).catch(() => null);
        const words = answer?.headers.get('Content-Type')?.startsWith('text/plain') && (await answer.text()).trim();
        const problem = words || (answer ? texts.elsewhere(answer.status, this.address.pathname) : texts.noAnswer);
        if (!this.isOpen) this.emit('unreachable', problem);
    }

    frame(data) {
        const length = new DataView(data).getUint32(0, true);
        const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
        // The next frame may be rendered while this one is decoded.
        this.send({ type: 'ack' });
        this.emit('frame', header, new Blob([new Uint8Array(data, 4 + length)], { type: header.format }));
    }

    get isOpen() { return this.socket?.readyState === WebSocket.OPEN; }

    send(message) {
        if (this.isOpen) this.socket.send(JSON.stringify(message));
        return this.isOpen;
    }
}
