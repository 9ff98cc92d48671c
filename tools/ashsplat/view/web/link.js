// The WebSocket: messages by type, frames, and coming back after it broke.

const FIRST_DELAY = 250, LONGEST_DELAY = 4000;

export class Link {
    constructor() {
        this.listeners = new Map();
        this.delay = FIRST_DELAY;
        this.socket = null;
        this.ended = false;
    }

    on(type, listener) {
        if (!this.listeners.has(type)) this.listeners.set(type, []);
        this.listeners.get(type).push(listener);
    }

    emit(type, ...values) {
        for (const listener of this.listeners.get(type) ?? []) listener(...values);
    }

    open() {
        const scheme = location.protocol === 'https:' ? 'wss:' : 'ws:';
        const socket = new WebSocket(`${scheme}//${location.host}/socket${location.search}`);
        socket.binaryType = 'arraybuffer';
        this.socket = socket;
        socket.onopen = () => {
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
            setTimeout(() => this.open(), this.delay);
            this.delay = Math.min(2 * this.delay, LONGEST_DELAY);
        };
    }

    frame(data) {
        const length = new DataView(data).getUint32(0, true);
        const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
        // What is shown next may be rendered while this is decoded.
        this.send({ type: 'ack' });
        this.emit('frame', header, new Blob([new Uint8Array(data, 4 + length)], { type: header.format }));
    }

    get isOpen() { return this.socket?.readyState === WebSocket.OPEN; }

    send(message) {
        if (this.isOpen) this.socket.send(JSON.stringify(message));
        return this.isOpen;
    }
}
