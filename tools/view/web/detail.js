// A tree of tiles: how much of it is drawn, and within which budget of Gaussians.

import { texts } from './texts.js';

const find = (id) => document.getElementById(id);
/** Steps of the slider, which is logarithmic. */
const STEPS = 100;

export class Detail {
    constructor() {
        this.tree = this.budget = null;
        this.changed = () => {};
        find('budget').max = STEPS;
        find('budget').oninput = () => {
            const [least, most] = this.range;
            this.budget = Math.round(least * (most / least) ** (Number(find('budget').value) / STEPS));
            this.showBudget();
            this.changed();
        };
    }

    open({ tree, gaussians }, first) {
        this.tree = tree;
        find('detail').hidden = !tree;
        if (!tree) return;
        this.range = [Math.max(tree.least, 1), Math.max(gaussians, tree.least, 2)];
        if (first) {
            this.budget = null;
            const [least, most] = this.range;
            const share = Math.log(Math.min(Math.max(tree.budget, least), most) / least) / Math.log(most / least);
            find('budget').value = STEPS * share || 0;
        }
        this.showBudget();
    }

    showBudget() {
        find('budget').parentElement.querySelector('output').textContent = short(this.budget ?? this.tree.budget);
    }

    showFrame({ tree, stats }) {
        if (!tree || !this.tree) return;
        find('detail-drawn').textContent = texts.detailDrawn(stats.gaussians, tree.of, tree.drawn);
        find('detail-tiles').textContent = texts.detailTiles(tree.wanted, tree.missing, tree.resident, tree.resident_gaussians);
        find('detail-problem').hidden = !tree.problem;
        find('detail-problem').textContent = tree.problem ? texts.coarserTile(tree.problem, tree.problems - 1) : '';
    }
}

/** 1234567 as 1.2M. */
function short(number) {
    for (const [unit, size] of [['M', 1e6], ['k', 1e3]]) if (number >= size) return `${Number((number / size).toPrecision(number >= 100 * size ? 3 : 2))}${unit}`;
    return String(number);
}
