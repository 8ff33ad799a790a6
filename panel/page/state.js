// The state of the bench as the page knows it, kept up to date with JSON merge patches (RFC 7396).

const isObject = value => typeof value === "object" && value !== null && !Array.isArray(value);

/** Applies a merge patch to a value; objects change in place. */
export function merge(target, patch) {
  if (!isObject(patch)) return patch;
  const result = isObject(target) ? target : {};
  for (const [name, value] of Object.entries(patch)) {
    if (value === null) delete result[name];
    else result[name] = merge(result[name], value);
  }
  return result;
}

/** One patch with the effect of two: members that the second removes stay as null. */
export function compose(first, second) {
  if (!isObject(first) || !isObject(second)) return second;
  for (const [name, value] of Object.entries(second)) first[name] = compose(first[name], value);
  return first;
}

/** Most frames that wait for the next animation frame; a hidden page gets none. */
const MOST_WAITING = 1000;

/** The state, and what has changed since the views were last drawn. */
export class Store {
  state = {};
  changes = {};
  traffic = [];
  leftOut = 0;
  whole = false;

  /** Takes an update in; a `whole` one replaces what was known. */
  take(update, whole) {
    if (whole) {
      this.state = {};
      this.changes = {};
      this.traffic = [];
      this.whole = true;
    }
    if (update.state) {
      this.state = merge(this.state, structuredClone(update.state));
      this.changes = compose(this.changes, update.state);
    }
    if (update.traffic) this.traffic.push(...update.traffic);
    this.leftOut += update.left_out ?? 0;
    if (this.traffic.length > MOST_WAITING) this.leftOut += this.traffic.splice(0, this.traffic.length - MOST_WAITING).length;
  }

  /** What the views have not drawn yet; the next call begins anew. */
  drain() {
    const { changes, traffic, leftOut, whole } = this;
    Object.assign(this, { changes: {}, traffic: [], leftOut: 0, whole: false });
    return { changes, traffic, leftOut, whole };
  }
}
