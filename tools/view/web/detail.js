// A tree of tiles: how much of it is drawn, and within which budget of Gaussians.

const find = (id) => document.getElementById(id);
/** Steps of the slider, which is logarithmic. */
const STEPS = 100;

const count = (number) => number.toLocaleString('en');

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
        find('detail-drawn').textContent = `${count(stats.gaussians)} of ${count(tree.of)} Gaussians in ${count(tree.drawn)} tiles`;
        const waits = tree.missing ? `, ${count(tree.missing)} on their way` : '';
        find('detail-tiles').textContent = `${count(tree.wanted)} tiles wanted${waits}; ${count(tree.resident)} in memory (${count(tree.resident_gaussians)} Gaussians)`;
        const more = tree.problems > 1 ? ` (and ${tree.problems - 1} more)` : '';
        find('detail-problem').hidden = !tree.problem;
        find('detail-problem').textContent = tree.problem ? `A coarser tile is drawn: ${tree.problem}${more}` : '';
    }
}

/** 1234567 as 1.2M. */
function short(number) {
    for (const [unit, size] of [['M', 1e6], ['k', 1e3]]) if (number >= size) return `${Number((number / size).toPrecision(number >= 100 * size ? 3 : 2))}${unit}`;
    return String(number);
}
