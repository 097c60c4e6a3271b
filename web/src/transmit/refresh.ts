// The display's refresh rate, by the times at which it asks for pictures; and the pattern rates that divide it.

/** Targets about which rates are offered, in patterns a second. */
const USUAL = [1, 2, 5, 10, 15, 20, 30, 60, 120];

/** Refreshes by which the rate is measured: half a second at 60 Hz. */
const MEASURED = 32;

/** Rates of displays that are taken for meant where one is near. */
const DISPLAYS = [24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 165, 180, 200, 240];

export function median(values: number[]): number {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[sorted.length >> 1] ?? NaN;
}

/** Measures the refresh rate in Hz; a page that is not seen has to wait for it. */
export function measured(): Promise<number> {
  return new Promise((done) => {
    const times: number[] = [];
    const tick = (now: number): void => {
      times.push(now);
      if (times.length <= MEASURED) requestAnimationFrame(tick);
      else done(near(1000 / median(times.slice(1).map((time, k) => time - times[k]!))));
    };
    requestAnimationFrame(tick);
  });
}

/** A usual display's rate near a measured one, or the measured one itself. */
export function near(rate: number): number {
  const nearest = DISPLAYS.reduce((best, one) => (Math.abs(one - rate) < Math.abs(best - rate) ? one : best));
  return Math.abs(nearest / rate - 1) < 0.01 ? nearest : rate;
}

/** Refreshes that a pattern may last, the slowest rate first. */
export function divisors(refresh: number): number[] {
  const counts = USUAL.filter((rate) => rate <= refresh * 1.01).map((rate) => Math.max(1, Math.round(refresh / rate)));
  return [...new Set(counts)].sort((a, b) => b - a);
}
