/** Whether this browser has seen the tour. */

const KEY = "isopeel.tour";

export function isTourDue(): boolean {
  try {
    return localStorage.getItem(KEY) === null;
  } catch {
    // Where storage is forbidden the tour would come each time.
    return false;
  }
}

export function endTour(): void {
  try {
    localStorage.setItem(KEY, "seen");
  } catch {
    // Storage may be forbidden.
  }
}
