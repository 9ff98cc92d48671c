// Training: its curves, and the page's commands to it.

import { number, texts } from './texts.js';

const find = (id) => document.getElementById(id);
const CURVES = [
    { name: 'loss', title: texts.loss, digits: 4, color: '#f0883e', log: true },
    { name: 'psnr', title: texts.psnr, digits: 2, color: '#56d364' },
    { name: 'gaussians', title: texts.trainedGaussians, digits: 0, color: '#58a6ff', zero: true },
    { name: 'rate', title: texts.rate, digits: 1, color: '#bc8cff', zero: true }
];
/** Interval between two status requests, ms. */
const INTERVAL = 500;

export class Training {
    constructor(link) {
        this.link = link;
        this.curves = Object.fromEntries(CURVES.map(({ name }) => [name, []]));
        this.since = 0;
        this.paused = false;
        for (const curve of CURVES) {
            curve.canvas = document.createElement('canvas');
            find('curves').append(curve.canvas);
        }
        find('train-pause').onclick = () => this.toggle();
        for (const action of ['step', 'save', 'stop']) find(`train-${action}`).onclick = () => this.act(action);
        link.on('status', (status) => this.show(status));
        link.on('ended', ({ message }) => { find('training-text').textContent = message; });
        setInterval(() => { if (this.active) link.send({ type: 'status', since: this.since }); }, INTERVAL);
    }

    open(iterations) {
        this.active = iterations !== null;
        find('training').hidden = !this.active;
        if (this.active) this.link.send({ type: 'status', since: this.since });
    }

    act(action) {
        this.link.send({ type: 'train', action });
    }

    toggle() {
        this.act(this.paused ? 'resume' : 'pause');
    }

    show({ iteration, iterations, paused, points, last }) {
        this.paused = paused;
        find('train-pause').textContent = paused ? texts.resume : texts.pause.text;
        find('train-step').disabled = !paused;
        find('training-bar').style.width = `${100 * iteration / iterations}%`;
        find('training-text').textContent = texts.progress(iteration, iterations, paused);
        // The program thins its curves as they grow, and then sends all points again.
        if (points.fresh) for (const name of Object.keys(this.curves)) this.curves[name] = [];
        for (const { name } of CURVES) this.curves[name].push(...points[name].filter(([at]) => at > (this.curves[name].at(-1)?.[0] ?? -1)));
        this.since = points.until;
        for (const curve of CURVES) this.plot(curve, iterations, last);
    }

    plot({ canvas, name, title, digits, color, log, zero }, iterations, last) {
        const ratio = devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight];
        canvas.width = width * ratio;
        canvas.height = height * ratio;
        const c = canvas.getContext('2d');
        c.scale(ratio, ratio);
        const points = this.curves[name], [top, bottom] = [19, height - 3];
        c.fillStyle = '#0f1216';
        c.beginPath(); c.roundRect(0, 0, width, height, 6); c.fill();
        c.font = '11px system-ui, sans-serif';
        c.fillStyle = '#8a929d';
        c.fillText(title, 7, 13);
        if (!points.length) return;
        const value = (v) => log ? Math.log(Math.max(v, 1e-6)) : v;
        const values = points.map(([, v]) => value(v));
        let low = zero ? 0 : Math.min(...values), high = Math.max(...values);
        if (high - low < 1e-9) { low -= 0.5; high += 0.5; }
        const end = Math.max(points.at(-1)[0], 1);
        const x = (i) => 6 + (width - 12) * points[i][0] / end;
        const y = (v) => bottom - 4 - (bottom - top - 6) * (v - low) / (high - low);
        c.beginPath();
        values.forEach((v, i) => i ? c.lineTo(x(i), y(v)) : c.moveTo(x(i), y(v)));
        if (values.length === 1) c.arc(x(0), y(values[0]), 1.5, 0, 2 * Math.PI);
        c.strokeStyle = color;
        c.lineWidth = 1.5;
        c.lineJoin = 'round';
        c.stroke();
        c.lineTo(x(values.length - 1), bottom);
        c.lineTo(x(0), bottom);
        c.globalAlpha = 0.12;
        c.fillStyle = color;
        c.fill();
        c.globalAlpha = 1;
        const now = last[name] ?? points.at(-1)[1];
        c.fillStyle = '#f3f5f8';
        c.textAlign = 'right';
        c.fillText(number(now, digits), width - 7, 13);
        c.textAlign = 'left';
    }
}
